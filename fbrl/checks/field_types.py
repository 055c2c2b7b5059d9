"""Checks the values of a dataclass against the types of its fields, as a file may hold anything."""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from typing import Any


class FieldTypeError(TypeError):
    """Raised for a value that is not of its field's type."""


def check_field_types(instance: Any) -> None:
    """Checks each field of a dataclass, but not those of dataclasses within it.

    A ``float`` may be an integer; an ``int`` may not be ``True``.

    Raises:
        FieldTypeError: A value is of another type; the message names the field and the value.
    """
    allowed = typing.get_type_hints(type(instance))
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if not _is_of(value, allowed[field.name]):
            name = getattr(allowed[field.name], "__name__", str(allowed[field.name]))
            raise FieldTypeError(f"{field.name} is {value!r:.200}; it must be of type {name}.")


def _is_of(value: Any, allowed: Any) -> bool:
    origin, arguments = typing.get_origin(allowed), typing.get_args(allowed)
    if origin in (typing.Union, types.UnionType):
        return any(_is_of(value, one) for one in arguments)
    if origin is tuple:  # of any length
        return isinstance(value, tuple) and all(_is_of(one, arguments[0]) for one in value)
    if isinstance(value, bool):
        return allowed is bool
    if allowed is float and isinstance(value, int):
        return abs(value) <= sys.float_info.max
    return isinstance(value, allowed)
