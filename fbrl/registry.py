"""How a component is found by its name or as ``module:Class``, checked and made.

Nothing here imports PyTorch: what a name stands for is imported when it is used.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from fbrl.checks import FieldTypeError, check_field_types, check_name, is_plain

_named: set[str] = set()


class ConfigError(ValueError):
    """Raised for a value that no training can be run with, or that can't be imported."""


def check_types(values: Any) -> None:
    """Raises :class:`ConfigError` for a value of another type than its field of a dataclass."""
    try:
        check_field_types(values)
    except FieldTypeError as error:
        raise ConfigError(str(error)) from error


@dataclass(frozen=True)
class Options:
    """Of a component: none, but for what a subclass has."""

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value out of range."""


@dataclass(frozen=True)
class BuiltIn:
    """A component of fbrl's own."""

    location: str
    """What makes it, as ``module:name``."""
    about: str
    """What it is, for a list of names."""
    options: type[Options] = Options
    """Arguments of what makes it, which can't be read without importing it."""


class Registry:
    """The components of a kind: fbrl's own, those of installed packages, and ``module:Class``.

    An installed package adds names with entry points of the group ``fbrl.<kind>s``, such as
    ``[project.entry-points."fbrl.rewards"] pressing = "my_package:PressingReward"``.

    ``module:Class`` names anything that can be called, in a module that :func:`import_modules` was
    given before, as commands do with what their command line names. A name that only a file holds
    has nothing imported or called.
    """

    def __init__(self, kind: str, **built_in: BuiltIn) -> None:
        self.kind = kind
        self.built_in = built_in

    @property
    def names(self) -> tuple[str, ...]:
        """Those of fbrl, then those of installed packages."""
        return tuple(dict.fromkeys([*self.built_in, *self._installed()]))

    def check(self, name: str) -> None:
        """Raises ``UnknownNameError`` for what is neither a name nor ``module:Class``."""
        if name not in self.built_in and module_of(name) is None:
            check_name(self.kind, name, (*self.names, "module:Class"))

    def check_options(self, name: str, values: Mapping[str, Any]) -> None:
        """Checks options, as far as their component can be read without importing anything.

        Raises:
            ConfigError: It has no such option, or one is of another type or out of range.
        """
        if name not in self.built_in and module_of(name) not in _named:
            return
        options = self.options(name)
        known = {f.name: f for f in fields(options)}
        self._check_known(name, values, known)
        missing = [key for key, f in known.items() if f.default is MISSING and key not in values]
        if missing:
            raise ConfigError(f"The {self.kind} {name} needs the option {missing[0]}.")
        given = options(**values)
        check_types(given)
        if isinstance(given, Options):
            given.check()

    def with_defaults(self, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """All options of one of fbrl's own; those of another as they are given."""
        own = fields(self.built_in[name].options) if name in self.built_in else ()
        return {f.name: f.default for f in own} | dict(values)

    def without_defaults(self, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Those options of one of fbrl's own that differ from what they are anyway."""
        defaults = self.with_defaults(name, {})
        return {k: v for k, v in values.items() if k not in defaults or defaults[k] != v}

    def options(self, name: str) -> Any:
        """A dataclass of the options that a component has.

        fbrl's own are described in :mod:`fbrl.components`. Of others they are the arguments of what
        is called that are numbers, texts, flags or lists of them. Raises what :meth:`load` raises.
        """
        if name in self.built_in:
            return self.built_in[name].options
        return _options_of(self.load(name))

    def load(self, name: str) -> Callable[..., Any]:
        """What makes the component.

        Raises:
            UnknownNameError: There is no such name.
            ConfigError: It can't be imported, or its module has nothing of this name.
        """
        self.check(name)
        location = name
        if name in self.built_in:
            location = self.built_in[name].location
        elif point := self._installed().get(name):
            try:
                return typing.cast("Callable[..., Any]", point.load())
            except Exception as error:  # whatever the package's code raises
                raise ConfigError(
                    f"{point.value}, which a package installed as {name}, can't be imported: "
                    f"{error}."
                ) from error
        module, _, attribute = location.partition(":")
        if location == name and module not in _named:
            raise ConfigError(
                f"The {self.kind} is {name}, but nothing is imported that only a file names. If "
                f"you trust {module}, add --import {module} (in Python: "
                f"fbrl.registry.import_modules([{module!r}]))."
            )
        found = getattr(importlib.import_module(module), attribute, None)
        if not callable(found):
            raise ConfigError(f"The {self.kind} is {name}, but {module} has no class {attribute}.")
        return typing.cast("Callable[..., Any]", found)

    def make(self, name: str, options: Mapping[str, Any], *given: Any, **context: Any) -> Any:
        """Makes the component; raises what :meth:`load` does, and whatever it raises itself.

        Args:
            name: Which one.
            options: Its options; a :class:`ConfigError` for one that it hasn't.
            given: Its first arguments.
            context: What it is told where it has an argument of this name that is no option, such
                as ``gamma``, the discount of the training.
        """
        component = self.load(name)
        taken = inspect.signature(component).parameters
        self._check_known(name, options, taken)
        told = {key: value for key, value in context.items() if key in taken}
        return component(*given, **told, **options)

    def _check_known(self, name: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
        for option in given:
            if option not in known:
                names = [f.name for f in fields(self.options(name))]
                has = f"it has {', '.join(names)}" if names else "it has none"
                raise ConfigError(f"The {self.kind} {name} has no option {option!r:.80}: {has}.")

    def _installed(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=f"fbrl.{self.kind}s")}


def import_modules(modules: Iterable[str]) -> None:
    """Imports modules, from the working directory too, so that their classes can be named.

    Raises:
        ConfigError: One can't be imported.
    """
    here = os.getcwd()
    if here not in sys.path:
        # At the end: no file that happens to lie here takes a library's place.
        sys.path.append(here)
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:  # whatever its code raises
            raise ConfigError(
                f"The module {module} can't be imported: {type(error).__name__}: {error}."
            ) from error
        _named.add(module)


def module_of(name: str | None) -> str | None:
    """The module of a ``module:Class``; None for another name."""
    module, _, attribute = str(name).partition(":")
    is_location = all(part.isidentifier() for part in (*module.split("."), attribute))
    return module if is_location else None


def _options_of(component: Callable[..., Any]) -> Any:
    called = component.__init__ if isinstance(component, type) else component  # type: ignore[misc]
    try:
        hints = typing.get_type_hints(called)
    except (NameError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"The types of {component.__name__}'s arguments can't be read: {error}."
        ) from error
    options: list[Any] = []
    for name, parameter in inspect.signature(component).parameters.items():
        # These two come from the training, so that a run has one of each.
        if name in ("gamma", "observation_shape") or not is_plain(hints.get(name)):
            continue
        default = MISSING if parameter.default is parameter.empty else parameter.default
        options.append((name, hints[name], field(default=default, kw_only=True)))
    return make_dataclass(
        component.__name__, options, namespace={"__doc__": component.__doc__}, frozen=True
    )
