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
        sticky_actions: The engine's actions that last until they are released.
        duration: Time limit of the episode in steps.
    """

    engine: Any
    info: Any
    sticky_actions: list[Any]
    duration: int


class MatchField(NamedTuple):
    """A key of the match: shape and dtype of its array, and how its numbers are read, in order."""

    shape: tuple[int, ...]
    dtype: NumberType
    read: Callable[[Snapshot], list[float]]


class PlayerField(NamedTuple):
    """A key of a team's players: shape and dtype of its array, and where its numbers come from.

    Attributes:
        team: The engine's name of the team.
        attribute: The engine's name of the property, a vector where the shape says (11, 2).
        padding: For players that the scenario lacks.
    """

    shape: tuple[int, ...]
    dtype: NumberType
    team: str
    attribute: str
    padding: int


def _vector(vector: Any) -> list[float]:
    return [vector[0], vector[1], vector[2]]


def _designated(players: Any) -> int:
    return next((i for i, player in enumerate(players) if player.designated_player), -1)


def _team_fields(team: str) -> dict[str, PlayerField]:
    planar, each = (MAX_PLAYERS, 2), (MAX_PLAYERS,)
    return {
        team: PlayerField(planar, np.float32, team, "position", PADDING),
        f"{team}_direction": PlayerField(planar, np.float32, team, "direction", PADDING),
        f"{team}_tired_factor": PlayerField(each, np.float32, team, "tired_factor", 0),
        f"{team}_yellow_card": PlayerField(each, np.int8, team, "has_card", 0),
        f"{team}_active": PlayerField(each, np.int8, team, "is_active", 0),
        f"{team}_roles": PlayerField(each, np.int64, team, "role", PADDING),
    }


def _number(read: Callable[[Snapshot], Any]) -> MatchField:
    return MatchField((), np.int64, lambda match: [read(match)])


FIELDS: dict[str, MatchField | PlayerField] = {
    "ball": MatchField((3,), np.float32, lambda match: _vector(match.info.ball_position)),
    "ball_direction": MatchField(
        (3,), np.float32, lambda match: _vector(match.info.ball_direction)
    ),
    "ball_rotation": MatchField((3,), np.float32, lambda match: _vector(match.info.ball_rotation)),
    **_team_fields("left_team"),
    **_team_fields("right_team"),
    "active": _number(lambda match: match.info.left_controllers[0].controlled_player),
    "designated": _number(lambda match: _designated(match.info.left_team)),
    "ball_owned_team": _number(lambda match: match.info.ball_owned_team),
    "ball_owned_player": _number(lambda match: match.info.ball_owned_player),
    "game_mode": _number(lambda match: match.info.game_mode),
    "score": MatchField(
        (2,), np.int64, lambda match: [match.info.left_goals, match.info.right_goals]
    ),
    "steps_left": _number(lambda match: match.duration - match.info.step),
    "sticky_actions": MatchField(
        (10,),
        np.int8,
        lambda match: [
            match.engine.sticky_action_state(action, True, 0) for action in match.sticky_actions
        ],
    ),
}
"""All keys; :mod:`fbrl.envs.observation` says what they mean."""


class _TeamReader:
    """Reads the wanted keys of a team: positions and directions in one pass over its players.

    Written out where it is passed most, because calls of Python functions cost most there.
    """

    def __init__(self, team: str, keys: Iterable[str]) -> None:
        wanted = {
            key: field
            for key in keys
            if isinstance(field := FIELDS[key], PlayerField) and field.team == team
        }
        self._team = team
        self._paddings = {
            key: [field.padding] * math.prod(field.shape) for key, field in wanted.items()
        }
        attributes = {field.attribute: key for key, field in wanted.items()}
        self._position = attributes.pop("position", None)
        self._direction = attributes.pop("direction", None)
        self._others = [(attrgetter(attribute), key) for attribute, key in attributes.items()]
        self.keys = list(wanted)

    def read(self, info: Any, into: dict[str, list[float]]) -> None:
        """Puts the numbers of each key into a dictionary."""
        players = getattr(info, self._team)
        # An index is quicker than the engine's own iterator.
        count = len(players)
        positions: list[float] = []
        directions: list[float] = []
        for index in range(count):
            player = players[index]
            if self._position:
                vector = player.position
                positions.append(vector[0])
                positions.append(vector[1])
            if self._direction:
                vector = player.direction
                directions.append(vector[0])
                directions.append(vector[1])
        if self._position:
            into[self._position] = positions
        if self._direction:
            into[self._direction] = directions
        for get, key in self._others:
            into[key] = [get(players[index]) for index in range(count)]
        for key, padding in self._paddings.items():
            into[key] += padding[len(into[key]) :]


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
        self._readers = [(key, getattr(FIELDS[key], "read", None)) for key in ordered]
        teams = [_TeamReader(team, ordered) for team in ("left_team", "right_team")]
        self._teams = [team for team in teams if team.keys]
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
        match = Snapshot(engine, info, sticky_actions, duration)
        of_players: dict[str, list[float]] = {}
        for team in self._teams:
            team.read(info, of_players)
        numbers: list[float] = []
        for key, read in self._readers:
            numbers += of_players[key] if read is None else read(match)
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


WHOLE_ROW = RowLayout(FIELDS)
"""Every key."""
