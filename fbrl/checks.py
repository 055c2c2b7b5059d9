"""Checks of what is given from outside, with errors that name the thing and the remedy."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import importlib.util
import numbers
import os
import sys
import types
import typing
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

_SCALARS = (bool, int, float, str, type(None))
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_count(name: str, count: Any, at_least: int = 1, at_most: int | None = None) -> int:
    """Returns the count as an ``int``; messages call it ``name``.

    Raises:
        TypeError: It is no integer; ``True`` is none either.
        ValueError: It is too small or too large.
    """
    if isinstance(count, bool) or not isinstance(count, numbers.Integral):
        raise TypeError(f"{name} is {count!r}; it must be an integer of at least {at_least}.")
    if count < at_least:
        raise ValueError(f"{name} is {count}; it must be at least {at_least}.")
    number = int(count)
    if at_most is not None and number > at_most:
        raise ValueError(f"{name} is {number}; it must be at most {at_most}.")
    return number


class UnknownNameError(ValueError):
    """Raised for a name that there is not, with the nearest and all names in its message."""


def check_name(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Returns the name if it is allowed; messages say what ``kind`` of name it is.

    Raises:
        UnknownNameError: The name is not among them.
    """
    names = list(allowed)
    if name in names:
        return name
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.3)
    hint = f" Did you mean {near[0]}?" if near else ""
    raise UnknownNameError(
        f"There is no {kind} {name!r:.100}.{hint} Choose from {', '.join(names)}."
    )


class FieldTypeError(TypeError):
    """Raised for a value that is not of its field's type."""


def check_field_types(instance: Any) -> None:
    """Checks each field of a dataclass, but not those of dataclasses within it.

    A ``float`` may be an integer; an ``int`` may not be ``True``.

    Raises:
        FieldTypeError: A value is of another type; the message names the field and the value.
    """
    kind: Any = type(instance)
    allowed = _field_types(kind)
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if not _is_of(value, allowed[field.name]):
            raise FieldTypeError(
                f"{field.name} is {value!r:.200}; it must be {_in_words(allowed[field.name])}."
            )


@functools.cache
def _field_types(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def is_plain(hint: Any) -> bool:
    """Whether all values of a type can be written on a command line and in JSON."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return all(type(value) in _SCALARS for value in arguments)
    if origin in (typing.Union, types.UnionType):
        return all(map(is_plain, arguments))
    if origin is tuple:
        return len(arguments) == 2 and arguments[1] is ... and is_plain(arguments[0])
    return hint in _SCALARS


def _is_of(value: Any, allowed: Any) -> bool:
    origin, arguments = typing.get_origin(allowed), typing.get_args(allowed)
    if origin in (typing.Union, types.UnionType):
        return any(_is_of(value, one) for one in arguments)
    if origin is typing.Literal:
        return any(value == one and type(value) is type(one) for one in arguments)
    if origin is tuple:  # of any length
        return isinstance(value, tuple) and all(_is_of(one, arguments[0]) for one in value)
    if origin is not None:
        return isinstance(value, origin)
    if isinstance(value, bool):
        return allowed is bool
    if allowed is float and isinstance(value, int):
        return abs(value) <= sys.float_info.max
    return isinstance(value, allowed)


def _in_words(allowed: Any) -> str:
    if typing.get_origin(allowed) is typing.Literal:
        return "one of " + ", ".join(map(str, typing.get_args(allowed)))
    return f"of type {getattr(allowed, '__name__', str(allowed))}"


def check_memory(what: str, needed: int, remedy: str) -> None:
    """Checks that the bytes needed, by a low estimate, fit into the memory that there is.

    Raises:
        ValueError: They don't; the message begins with what needs them, and ends with the remedy.
    """
    present = memory_limit()
    if needed > present:
        raise ValueError(
            f"{what} would take {needed / 2**30:,.1f} GiB of memory, of {present / 2**30:,.1f} GiB "
            f"here. {remedy}"
        )


def memory_limit() -> int:
    """The machine's memory, or what a container or a job's limit leaves of it; bytes."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        return min(machine, int(_GROUP_LIMIT.read_text(encoding="utf-8")))
    except (OSError, ValueError):  # no limit
        return machine


class MissingExtraError(ImportError):
    """Raised where what is asked for needs packages of an extra that are not installed."""

    def __init__(self, what: str, packages: Sequence[str], extra: str) -> None:
        super().__init__(
            f"{what} need {' and '.join(packages)}, not installed here: "
            f"`pip install 'fbrl[{extra}]'`."
        )


def missing_packages(packages: Sequence[str]) -> list[str]:
    """Those of some packages, by the names that they are imported by, that are not installed."""
    return [name for name in packages if importlib.util.find_spec(name) is None]
