"""What a football environment observes: keys, shapes, dtypes, and how they are read from a match.

===============================  ========  =====  ==================================================
key                              shape     dtype  meaning
===============================  ========  =====  ==================================================
``ball``                         (3,)      f32    x, y in pitch units and z in metres
``ball_direction``               (3,)      f32    movement per step
``ball_rotation``                (3,)      f32    rotation per step, radians
``left_team``                    (11, 2)   f32    x, y of each player of the controlled team
``left_team_direction``          (11, 2)   f32    movement per step
``left_team_tired_factor``       (11,)     f32    0 (fresh) to 1
``left_team_yellow_card``        (11,)     int8   1 for a player who has a yellow card
``left_team_active``             (11,)     int8   0 for a player who was sent off, and for padding
``left_team_roles``              (11,)     int64  0 keeper, 1 to 9 as in gfootball, -1 for padding
``right_team`` and so on                          the same for the opponents
``active``                       ()        int64  index of the controlled player in the left team
``designated``                   ()        int64  index of the player whom the team's play is about
``ball_owned_team``              ()        int64  -1 nobody, 0 left, 1 right
``ball_owned_player``            ()        int64  index in that team, -1 nobody
``game_mode``                    ()        int64  0 normal, 1 kick-off, 2 goal kick, 3 free kick,
                                                  4 corner, 5 throw-in, 6 penalty
``score``                        (2,)      int64  goals of the left and of the right team
``steps_left``                   ()        int64  steps until the time limit
``sticky_actions``               (10,)     int8   directions 1 to 8, sprint, dribble: 1 where held
===============================  ========  =====  ==================================================

The pitch spans x in [-1, 1] (54.4 m a unit) and y in [-0.42, 0.42] (83.6 m a unit, growing
downwards); the controlled team attacks towards x = 1. Players, and the ball, can be outside it.

Scenarios with fewer than eleven players a side are padded at the end: positions and directions
with -1 (as in gfootball's ``simple115v2``), flags and tiredness with 0, and roles with -1. A
player exists exactly where the role is not -1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from fbrl.envs.engine import MATCH_FIELDS, MAX_PLAYERS, PADDING, PLAYER_FIELDS, ROW_LENGTH

Observation = dict[str, Any]
"""An array for each key; not ``np.ndarray`` in the type because Gymnasium's ``Dict`` says so."""

_PLAYER_KEYS = {
    "position": "{team}",
    "direction": "{team}_direction",
    "tired_factor": "{team}_tired_factor",
    "yellow_card": "{team}_yellow_card",
    "active": "{team}_active",
    "role": "{team}_roles",
}
_FIELDS_PER_PLAYER = sum(PLAYER_FIELDS.values())


def _unbounded(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def _integer(low: int, high: int, *shape: int) -> spaces.Box:
    return spaces.Box(low, high, shape, np.int64)


def _team_space(team: str) -> dict[str, spaces.Space]:
    return {
        team: _unbounded(MAX_PLAYERS, 2),
        f"{team}_direction": _unbounded(MAX_PLAYERS, 2),
        f"{team}_tired_factor": spaces.Box(0.0, 1.0, (MAX_PLAYERS,), np.float32),
        f"{team}_yellow_card": spaces.Box(0, 1, (MAX_PLAYERS,), np.int8),
        f"{team}_active": spaces.Box(0, 1, (MAX_PLAYERS,), np.int8),
        f"{team}_roles": _integer(PADDING, 9, MAX_PLAYERS),
    }


OBSERVATION_SPACE = spaces.Dict(
    {
        "ball": _unbounded(3),
        "ball_direction": _unbounded(3),
        "ball_rotation": _unbounded(3),
        **_team_space("left_team"),
        **_team_space("right_team"),
        "active": _integer(-1, MAX_PLAYERS - 1),
        "designated": _integer(-1, MAX_PLAYERS - 1),
        "ball_owned_team": _integer(-1, 1),
        "ball_owned_player": _integer(-1, MAX_PLAYERS - 1),
        "game_mode": _integer(0, 6),
        "score": _integer(0, 1000, 2),
        "steps_left": _integer(0, 10_000),
        "sticky_actions": spaces.Box(0, 1, (10,), np.int8),
    }
)
"""The whole observation of one match."""


def select_space(keys: Iterable[str] | None) -> spaces.Dict:
    """The part of :data:`OBSERVATION_SPACE` with these keys, all of it for ``None``.

    Raises:
        ValueError: A key is unknown.
    """
    if keys is None:
        return OBSERVATION_SPACE
    wanted = set(keys)
    unknown = wanted - set(OBSERVATION_SPACE)
    if unknown:
        raise ValueError(
            f"Unknown observation keys {sorted(unknown)}; there are {list(OBSERVATION_SPACE)}."
        )
    return spaces.Dict({key: space for key, space in OBSERVATION_SPACE.items() if key in wanted})


def empty_rows(num_matches: int) -> np.ndarray:
    """Rows for :meth:`fbrl.envs.engine.Match.read`, shape (num_matches, ROW_LENGTH), padded."""
    rows = np.zeros((num_matches, ROW_LENGTH))
    pad_players(rows)
    return rows


def pad_players(rows: np.ndarray) -> None:
    """Marks all players of the rows as missing; a match then writes over those that it has."""
    players = rows[..., : 2 * MAX_PLAYERS * _FIELDS_PER_PLAYER]
    players = players.reshape(*rows.shape[:-1], 2 * MAX_PLAYERS, _FIELDS_PER_PLAYER)
    column = 0
    for field, width in PLAYER_FIELDS.items():
        padded = field in ("position", "direction", "role")
        players[..., column : column + width] = PADDING if padded else 0
        column += width


def _columns() -> dict[str, np.ndarray]:
    """For each key the columns of a row that hold it, in the key's own shape."""
    columns = {}
    first = 0
    players = np.arange(MAX_PLAYERS) * _FIELDS_PER_PLAYER
    for team in ("left_team", "right_team"):
        offset = first
        for field, width in PLAYER_FIELDS.items():
            key = _PLAYER_KEYS[field].format(team=team)
            columns[key] = offset + players[:, None] + np.arange(width)
            offset += width
        first += MAX_PLAYERS * _FIELDS_PER_PLAYER
    for key, width in MATCH_FIELDS.items():
        columns[key] = first + np.arange(width)
        first += width
    return {key: columns[key].reshape(OBSERVATION_SPACE[key].shape) for key in OBSERVATION_SPACE}


_COLUMNS = _columns()


def split_rows(rows: np.ndarray, space: Mapping[str, spaces.Space]) -> Observation:
    """Copies rows into one array per key, so that the rows may be written again.

    Args:
        rows: float64, shape (..., ROW_LENGTH). The engine's floats are single precision, so the
            conversion to float32 loses nothing.
        space: The wanted keys, as :func:`select_space` returns them.

    Returns:
        For each key an array of shape (..., *shape of the key) with the key's dtype.
    """
    return {
        key: np.asarray(rows[..., _COLUMNS[key]], dtype=key_space.dtype)
        for key, key_space in space.items()
    }
