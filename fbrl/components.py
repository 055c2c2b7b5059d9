"""Rewards, observations, action masks, networks and loggers, by name or as ``module:Class``.

Nothing here imports PyTorch: what a name stands for is imported when it is used.
"""

from __future__ import annotations

import importlib
import inspect
import math
import os
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from fbrl.checks.field_types import FieldTypeError, check_field_types, is_plain
from fbrl.checks.names import check_name


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
class DensityOptions(Options):
    """Of the rewards that pay for where the ball is."""

    density: str | None = field(default=None, metadata={"values": "FILE|uniform|mirrored|shuffled"})
    """File of the assist densities (see fbrl-density fit), or uniform, mirrored or shuffled, the
    controls; by default those that fbrl ships."""
    weight: float = 1.0
    """Factor of what the densities pay."""


@dataclass(frozen=True)
class AnalyticsOptions(DensityOptions):
    """See :class:`fbrl.transforms.AssistDensityReward`."""

    transition: Literal["possession", "consecutive"] = "possession"
    """What counts as a received pass: possession (the last controlled player with the ball was
    another one) or consecutive (the controlled player changed in this very step)."""
    start_weight: float = 1.0
    """Further factor of the start density; with 0 the end density pays alone."""
    end_weight: float = 1.0
    """That of the end density."""
    episode_cap: float | None = None
    """What the densities can pay in one match at most, in goals; by default there is no limit."""
    release_at_goal: bool = False
    """Withhold what the densities earn until the own team scores; without a goal it is lost."""

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value out of range."""
        cap = self.episode_cap
        if cap is not None and not (math.isfinite(cap) and cap >= 0):
            raise ConfigError(f"episode_cap is {cap}; it must be a number of at least 0.")


@dataclass(frozen=True)
class PotentialOptions(DensityOptions):
    """See :class:`fbrl.transforms.AssistDensityPotential`."""

    start_weight: float = 100.0
    """Factor of the start density within the potential."""


@dataclass(frozen=True)
class ExpertMaskOptions(Options):
    """See :class:`fbrl.transforms.ExpertActionMask`."""

    shot_from_x: float = 0.64
    """Where the zone begins from which shots are allowed; it ends at the goal line."""
    shot_half_width: float = 0.27
    """Half the zone's width."""
    mask_idle: bool = False
    """Mask idle, too."""


@dataclass(frozen=True)
class FramesOptions(Options):
    """Of the mini maps."""

    num_frames: int = 4
    """How many of the latest frames are stacked."""


@dataclass(frozen=True)
class PixelsOptions(Options):
    """See :class:`fbrl.transforms.Pixels`."""

    height: int = 72
    """Of the picture, pixels."""
    width: int = 96
    """Likewise."""


@dataclass(frozen=True)
class MLPOptions(Options):
    """See :class:`fbrl.models.MLP`."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Layer widths of the perceptron."""
    activation: Literal["relu", "tanh"] = "relu"
    """Its activation."""

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value out of range."""
        sizes = self.hidden_sizes
        if not (1 <= len(sizes) <= 64 and min(sizes) >= 1):
            raise ConfigError(
                f"hidden_sizes is {sizes!s:.100}; it must be 1 to 64 positive widths."
            )


@dataclass(frozen=True)
class PlayerSetOptions(MLPOptions):
    """See :class:`fbrl.models.PlayerSet`."""

    embedding_size: int = 32
    """Numbers of a player's embedding."""


@dataclass(frozen=True)
class ImpalaOptions(Options):
    """See :class:`fbrl.models.ImpalaCNN`."""

    precision: Literal["float32", "bfloat16"] = "float32"
    """What it computes in; bfloat16 takes half the memory, and half the time on CPUs with AMX and
    on GPUs."""


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

        fbrl's own are described in this module. Of others they are the arguments of what is called
        that are numbers, texts, flags or lists of them. Raises what :meth:`load` raises.
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
                f"fbrl.components.import_modules([{module!r}]))."
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


REWARDS = Registry(
    "reward",
    analytics=BuiltIn(
        "fbrl.transforms:AssistDensityReward",
        "goals, and having the ball where real assists are made",
        AnalyticsOptions,
    ),
    potential=BuiltIn(
        "fbrl.transforms:AssistDensityPotential",
        "the same densities as a potential, which leaves the best policy that of goals",
        PotentialOptions,
    ),
    checkpoints=BuiltIn(
        "fbrl.transforms:CheckpointReward", "gfootball's ten rewards on the way to the goal"
    ),
    scoring=BuiltIn("fbrl.transforms:ScoringReward", "goals alone"),
)
"""Subclasses of :class:`fbrl.transforms.ScoringReward`; ``gamma`` is the training's discount."""

OBSERVATIONS = Registry(
    "observation",
    simple115=BuiltIn("fbrl.transforms:Simple115", "115 numbers"),
    players=BuiltIn(
        "fbrl.transforms.players:players_with_memory",
        "274 numbers relative to the controlled player",
    ),
    minimap=BuiltIn(
        "fbrl.transforms:MiniMapCells", "stacked mini maps as cell indices", FramesOptions
    ),
    smm=BuiltIn("fbrl.transforms:SuperMiniMap", "the same as dense planes", FramesOptions),
    pixels=BuiltIn(
        "fbrl.transforms:Pixels", "a small picture of the match from above", PixelsOptions
    ),
)
"""TorchRL transforms, such as :class:`fbrl.transforms.RawObservationTransform`'s subclasses; the
network reads the last key that they write."""

PICTURES = ("minimap", "smm", "pixels")
"""Those of them that a convolutional network reads."""

MASKS = Registry(
    "mask",
    engine=BuiltIn("fbrl.transforms:EngineActionMask", "those that the engine ignores in a state"),
    expert=BuiltIn(
        "fbrl.transforms:ExpertActionMask",
        "these, and what experts of this environment rule out, such as shots from afar",
        ExpertMaskOptions,
    ),
)
"""TorchRL transforms that write ``action_mask``, bool (..., 19)."""

NETWORKS = Registry(
    "network",
    mlp=BuiltIn("fbrl.models:MLP", "a perceptron", MLPOptions),
    player_set=BuiltIn(
        "fbrl.models:PlayerSet",
        "team-mates and opponents of the observation players as sets",
        PlayerSetOptions,
    ),
    impala=BuiltIn("fbrl.models:ImpalaCNN", "the convolutions of gfootball's paper", ImpalaOptions),
)
"""Modules from an observation (..., *shape) to features (..., n); the first argument is shape."""

COMPONENTS = {"reward": REWARDS, "observation": OBSERVATIONS, "mask": MASKS, "network": NETWORKS}
"""What a training is made of, by kind."""

LOGGERS = Registry(
    "logger",
    wandb=BuiltIn("fbrl.monitor.services:open_wandb", "Weights & Biases"),
    mlflow=BuiltIn("fbrl.monitor.services:open_mlflow", "MLflow"),
)
"""Take a run's directory and the service's name of the run, and return a
:class:`fbrl.monitor.services.Service`."""


_named: set[str] = set()


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
        # The first two come from the training, so that a run has one of each.
        if name in ("gamma", "observation_shape") or not is_plain(hints.get(name)):
            continue
        default = MISSING if parameter.default is parameter.empty else parameter.default
        options.append((name, hints[name], field(default=default, kw_only=True)))
    return make_dataclass(
        component.__name__, options, namespace={"__doc__": component.__doc__}, frozen=True
    )
