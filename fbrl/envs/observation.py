"""What a football environment observes: :data:`OBSERVATION_SPACE`, and what its keys mean.

:class:`~fbrl.envs.FootballEnv` has the single numbers, of shape (), as arrays of shape (1,), since
other libraries' networks and checkers ask for arrays.

The pitch spans x in [-1, 1] (54.4 m a unit) and y in [-0.42, 0.42] (83.6 m a unit, growing
downwards); the controlled team attacks towards x = 1. Players, and the ball, can be outside it.

Scenarios with fewer than eleven players a side are padded at the end: positions and directions
with -1 (as in gfootball's ``simple115v2``), flags and tiredness with 0, and roles with -1. A
player exists exactly where the role is not -1.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

MAX_PLAYERS = 11

MAX_DURATION = 10**9
"""Steps of a match at most, and so its goals; three years of play."""

PADDING = -1
"""Fills positions, directions and roles of the players that a small-sided scenario lacks."""

Observation = dict[str, Any]
"""An array for each key; not ``np.ndarray`` in the type because Gymnasium's ``Dict`` says so."""


def _real(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def _integer(low: int, high: int, *shape: int) -> spaces.Box:
    return spaces.Box(low, high, shape, np.int64)


def _flags(number: int) -> spaces.Box:
    return spaces.Box(0, 1, (number,), np.int8)


def _team_space(team: str) -> dict[str, spaces.Space]:
    return {
        team: _real(MAX_PLAYERS, 2),  # x, y of each player
        f"{team}_direction": _real(MAX_PLAYERS, 2),  # movement per step
        f"{team}_tired_factor": spaces.Box(0, 1, (MAX_PLAYERS,), np.float32),  # 0 is fresh
        f"{team}_yellow_card": _flags(MAX_PLAYERS),  # who has one
        f"{team}_active": _flags(MAX_PLAYERS),  # 0 for who was sent off, and for padding
        # 0 keeper, 1 to 9 as in gfootball, -1 for padding
        f"{team}_roles": _integer(PADDING, 9, MAX_PLAYERS),
    }


OBSERVATION_SPACE = spaces.Dict(
    {
        "ball": _real(3),  # x, y in pitch units and z in metres
        "ball_direction": _real(3),  # movement per step
        "ball_rotation": _real(3),  # rotation per step, radians
        **_team_space("left_team"),  # the controlled team
        **_team_space("right_team"),
        "active": _integer(-1, MAX_PLAYERS - 1),  # the controlled player in the left team
        "designated": _integer(-1, MAX_PLAYERS - 1),  # whom the team's play is about
        "ball_owned_team": _integer(-1, 1),  # -1 nobody, 0 left, 1 right
        "ball_owned_player": _integer(-1, MAX_PLAYERS - 1),  # in that team, -1 nobody
        # 0 normal, 1 kick-off, 2 goal kick, 3 free kick, 4 corner, 5 throw-in, 6 penalty
        "game_mode": _integer(0, 6),
        "score": _integer(0, MAX_DURATION, 2),  # goals of the left and of the right team
        "steps_left": _integer(0, MAX_DURATION),  # until the time limit
        "sticky_actions": _flags(10),  # which of directions 1 to 8, sprint, dribble are held
    }
)
"""The whole observation of one match."""


def select_space(keys: Iterable[str] | None) -> spaces.Dict:
    """The part of :data:`OBSERVATION_SPACE` with these keys, all of it for ``None``.

    Raises:
        ValueError: A key is unknown.
        TypeError: They are no list of keys.
    """
    if keys is None:
        return OBSERVATION_SPACE
    if isinstance(keys, str) or not isinstance(keys, Iterable):
        raise TypeError(f"The observation keys are {keys!r}; they must be a list of names.")
    wanted, known = list(keys), list(OBSERVATION_SPACE)
    unknown = [key for key in wanted if key not in known]
    if unknown:
        raise ValueError(f"Unknown observation keys {sorted(unknown, key=str)}; there are {known}.")
    return spaces.Dict({key: space for key, space in OBSERVATION_SPACE.items() if key in wanted})


def without_scalars(observed: spaces.Dict) -> spaces.Dict:
    """The same observation with single numbers as arrays of shape (1,)."""
    # A batch of one is what makes a scalar an array.
    return spaces.Dict(
        {key: space if space.shape else batch_space(space, 1) for key, space in observed.items()}
    )
