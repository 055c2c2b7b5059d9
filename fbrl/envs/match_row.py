"""The numbers that describe a match, and how they get from the engine into arrays.

A row holds the numbers of one match, those of each key side by side. Only what the wanted keys
need is asked of the engine: each attribute of its objects is a call into C++, and after a step
has filled the processor's caches with other things, such calls are not cheap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np

MAX_PLAYERS = 11

PADDING = -1
"""Fills positions, directions and roles of the players that a small-sided scenario lacks."""


NumberType: TypeAlias = type[np.floating[Any]] | type[np.integer[Any]]


class Snapshot(NamedTuple):
    """The engine's objects that a row is read from, valid until the engine's next step.

    Attributes:
        engine: ``gfootball_engine.GameEnv``.
        info: What its ``get_info()`` returned after the last step.
        left_team: Its players of the left team; empty where no key needs players.
        right_team: The same of the right team.
        sticky_actions: The engine's actions that last until they are released.
        duration: Time limit of the episode in steps.
    """

    engine: Any
    info: Any
    left_team: list[Any]
    right_team: list[Any]
    sticky_actions: list[Any]
    duration: int


class Field(NamedTuple):
    """One key: the shape and dtype of its array, and how its numbers are read, in order."""

    shape: tuple[int, ...]
    dtype: NumberType
    read: Callable[[Snapshot], list[float]]


def _vector(vector: Any) -> list[float]:
    return [vector[0], vector[1], vector[2]]


def _planar(vectors: Iterable[Any]) -> list[float]:
    values: list[float] = []
    for vector in vectors:
        values += (vector[0], vector[1])
    return values


def _designated(players: list[Any]) -> int:
    return next((i for i, player in enumerate(players) if player.designated_player), -1)


def _team_fields(team: str) -> dict[str, Field]:
    get_players = attrgetter(team)

    def planar(attribute: str) -> Field:
        get = attrgetter(attribute)

        def read(match: Snapshot) -> list[float]:
            values = _planar(map(get, get_players(match)))
            return values + [PADDING] * (2 * MAX_PLAYERS - len(values))

        return Field((MAX_PLAYERS, 2), np.float32, read)

    def single(attribute: str, dtype: NumberType, padding: int) -> Field:
        get = attrgetter(attribute)

        def read(match: Snapshot) -> list[float]:
            values = list(map(get, get_players(match)))
            return values + [padding] * (MAX_PLAYERS - len(values))

        return Field((MAX_PLAYERS,), dtype, read)

    return {
        team: planar("position"),
        f"{team}_direction": planar("direction"),
        f"{team}_tired_factor": single("tired_factor", np.float32, 0),
        f"{team}_yellow_card": single("has_card", np.int8, 0),
        f"{team}_active": single("is_active", np.int8, 0),
        f"{team}_roles": single("role", np.int64, PADDING),
    }


def _number(read: Callable[[Snapshot], Any]) -> Field:
    return Field((), np.int64, lambda match: [read(match)])


FIELDS: dict[str, Field] = {
    "ball": Field((3,), np.float32, lambda match: _vector(match.info.ball_position)),
    "ball_direction": Field((3,), np.float32, lambda match: _vector(match.info.ball_direction)),
    "ball_rotation": Field((3,), np.float32, lambda match: _vector(match.info.ball_rotation)),
    **_team_fields("left_team"),
    **_team_fields("right_team"),
    "active": _number(lambda match: match.info.left_controllers[0].controlled_player),
    "designated": _number(lambda match: _designated(match.left_team)),
    "ball_owned_team": _number(lambda match: match.info.ball_owned_team),
    "ball_owned_player": _number(lambda match: match.info.ball_owned_player),
    "game_mode": _number(lambda match: match.info.game_mode),
    "score": Field((2,), np.int64, lambda match: [match.info.left_goals, match.info.right_goals]),
    "steps_left": _number(lambda match: match.duration - match.info.step),
    "sticky_actions": Field(
        (10,),
        np.int8,
        lambda match: [
            match.engine.sticky_action_state(action, True, 0) for action in match.sticky_actions
        ],
    ),
}
"""All keys; :mod:`fbrl.envs.observation` says what they mean."""


class RowLayout:
    """Which keys are read from a match, and where their numbers lie in its row.

    Args:
        keys: Names in :data:`FIELDS`.

    Attributes:
        length: How many numbers a row has.
    """

    def __init__(self, keys: Iterable[str]) -> None:
        # Side by side with those of their dtype, the keys are converted together.
        ordered = sorted(keys, key=lambda key: np.dtype(FIELDS[key].dtype).name)
        self._readers = [FIELDS[key].read for key in ordered]
        self._reads_left = any(key.startswith(("left_team", "designated")) for key in ordered)
        self._reads_right = any(key.startswith("right_team") for key in ordered)
        self._parts = []
        self.length = 0
        for dtype, same in groupby(ordered, key=lambda key: FIELDS[key].dtype):
            first, columns = self.length, {}
            for key in same:
                start = self.length - first
                self.length += math.prod(FIELDS[key].shape)
                columns[key] = slice(start, self.length - first)
            self._parts.append((dtype, slice(first, self.length), columns))

    def rows(self, num_matches: int) -> np.ndarray:
        """Rows to be read into, shape (num_matches, length).

        They are of single precision, as the engine's numbers are; its integers are small.
        """
        return np.zeros((num_matches, self.length), np.float32)

    def read(
        self, row: np.ndarray, engine: Any, info: Any, sticky_actions: list[Any], duration: int
    ) -> None:
        """Reads a match into its row, shape (length,); see :class:`Snapshot`."""
        match = Snapshot(
            engine,
            info,
            _players(info.left_team) if self._reads_left else [],
            _players(info.right_team) if self._reads_right else [],
            sticky_actions,
            duration,
        )
        numbers: list[float] = []
        for read in self._readers:
            numbers += read(match)
        row[:] = numbers

    def split(self, rows: np.ndarray) -> dict[str, Any]:
        """Copies rows into one array per key, so that the rows may be written again.

        Args:
            rows: Shape (..., length).

        Returns:
            For each key an array of shape (..., *shape of the key) with the key's dtype.
        """
        arrays = {}
        for dtype, part, columns in self._parts:
            converted = rows[..., part].astype(dtype)
            for key, column in columns.items():
                shape = (*rows.shape[:-1], *FIELDS[key].shape)
                arrays[key] = converted[..., column].reshape(shape)
        return arrays


def _players(team: Any) -> list[Any]:
    # An index is quicker than the engine's own iterator.
    return [team[index] for index in range(len(team))]


WHOLE_ROW = RowLayout(FIELDS)
"""Every key."""
