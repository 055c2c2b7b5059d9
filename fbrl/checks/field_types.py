"""Checks the values of a dataclass against the types of its fields, as a file may hold anything."""

from __future__ import annotations

import dataclasses
import functools
import sys
import types
import typing
from typing import Any

_SCALARS = (bool, int, float, str, type(None))


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
