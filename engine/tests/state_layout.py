"""What lies where in the bytes of an engine's state."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from state_fields import STRUCTURES

_SIZES = {
    **dict.fromkeys("bc", 1),
    **dict.fromkeys("iuefp", 4),
    "l": 8,
    "v": 12,
    "q": 16,
    "r": 8,
}
# More of something than any vector of a state has: the fields don't fit the bytes.
_MOST_ELEMENTS = 5000
_FIELD = re.compile(r"(\w+) (\w+)(\*|\[(\w+)\])?")


class Field(NamedTuple):
    """A field, or several of the same simple type side by side.

    Attributes:
        name: Of the field, behind those of the structures that it is part of.
        kind: One letter; see :mod:`state_fields`.
        start: Its first byte.
        stop: Behind its last one.
    """

    name: str
    kind: str
    start: int
    stop: int


def _parse() -> dict[str, list[tuple[str, str, str]]]:
    structures = {}
    for block in STRUCTURES.strip().split("\n\n"):
        name, _, fields = block.partition("\n")
        structures[name] = [
            (field, kind, number or many) for field, kind, many, number in _FIELD.findall(fields)
        ]
    return structures


class _Reader:
    def __init__(self, state: bytes) -> None:
        self._state = state
        self._position = 0
        self._structures = _parse()
        self._values: dict[str, int] = {}

    def fields(self, structure: str, path: str) -> Iterator[Field]:
        for name, kind, many in self._structures[structure]:
            number = self._number(many)
            if kind in _SIZES:
                start = self._position
                self._position += number * _SIZES[kind]
                self._values[name] = self._integer(start)
                yield Field(path + name, kind, start, self._position)
                continue
            for index in range(number):
                part = f"{path}{name}[{index}]." if many else f"{path}{name}."
                yield from self.fields(kind, part)

    def _number(self, many: str) -> int:
        if not many:
            return 1
        if many == "*":
            self._position += 4
            number = self._integer(self._position - 4)
            if number > _MOST_ELEMENTS:
                raise ValueError(f"At byte {self._position} there are {number} elements.")
            return number
        if many == "players":
            return self._values["left_players"] + self._values["right_players"]
        if many == "isActive":
            return self._values["isActive"] & 1
        return int(many)

    def _integer(self, position: int) -> int:
        return int.from_bytes(self._state[position : position + 4], "little")

    def check_end(self) -> None:
        if self._position != len(self._state):
            raise ValueError(
                f"The fields end at byte {self._position} of a state of {len(self._state)} bytes."
            )


def fields(state: bytes) -> Iterator[Field]:
    """The fields of a state, in order; the numbers of elements before vectors are none.

    Raises:
        ValueError: The bytes are not those of such fields.
    """
    reader = _Reader(state)
    yield from reader.fields("State", "")
    reader.check_end()


def foul_type(state: bytes) -> int:
    """The referee's last foul: 0 for none, 2 and 3 for one with a card.

    It lies before what the state ends with: whether there is advantage (1 byte), the time (8), the
    position (12), and whether the foul has been dealt with (1).
    """
    return int.from_bytes(state[-26:-22], "little")


def hide_uninitialised(state: bytes) -> bytes:
    """The state with zeros for the bytes that the engine never sets.

    They are the last three of the eight of each ``radian``: a float, a bool, and the padding that
    the compiler puts behind it (``base/math/bluntmath.hpp``). States of two runs of pip's engine,
    one of them with memory that malloc had filled, differed in these bytes and in no other.
    """
    hidden = bytearray(state)
    for field in fields(state):
        if field.kind == "r":
            hidden[field.start + 5 : field.stop] = bytes(3)
    return bytes(hidden)


def differing_fields(state: bytes, other: bytes) -> list[str]:
    """Names of the fields whose set bytes differ; all that is known where the lengths do, too."""
    if len(state) != len(other):
        return [f"length {len(state)} and {len(other)}"]
    state, other = hide_uninitialised(state), hide_uninitialised(other)
    return [
        field.name
        for field in fields(state)
        if state[field.start : field.stop] != other[field.start : field.stop]
    ]
