"""What the controlled player sees: numbers relative to it, players by their distance.

They are computed in numpy, for a whole batch at once: between two steps of the engine a hundred
operations on a few numbers each cost a fifth of what they cost as tensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.envs import Compose

from fbrl.density.coordinates import HALF_LENGTH, METRES_PER_UNIT
from fbrl.transforms.action_memory import KICKS, ActionMemory
from fbrl.transforms.players_table import (
    MATES,
    NUM_FEATURES,
    NUM_MATES,
    OPPONENTS,
    PLAYER_FEATURES,
    PLAYERS_FEATURES,
    SINGLE_FEATURES,
)
from fbrl.transforms.raw_observation import RawObservationTransform

__all__ = ["PLAYERS_FEATURES", "Players", "players_with_memory"]

KICK_WAITS_STEPS = 20
"""A kick waits at most that long for the ball: 2000 ms in the engine's ``humancontroller.cpp``."""

Array = NDArray[Any]
Fields = Mapping[str, Array]

_OF_A_TEAM = ("", "_direction", "_tired_factor", "_active", "_roles")

_METRES = 25.0
_STEPS_PER_SECOND = 10
_PLACE = np.array(METRES_PER_UNIT, np.float32) / _METRES
_PLAYER_VELOCITY = np.array(METRES_PER_UNIT, np.float32) * _STEPS_PER_SECOND / 5
_BALL_VELOCITY = np.array([*METRES_PER_UNIT, 1], np.float32) * _STEPS_PER_SECOND / 10
_HEIGHT = 2.0
_OPENING = 0.25
_GOAL = np.array([HALF_LENGTH, 0], np.float32) * _PLACE
_HALF_GOAL = 0.044 * _PLACE[1]

_BALL = 22
"""The ball's row, after the players of both teams."""
_PLAYERS = np.arange(_BALL)
_COLUMN = {name: column for column, name in enumerate(SINGLE_FEATURES)}
_ONE_HOTS = slice(_COLUMN["last_idle"], _COLUMN["ball_is_opponents"] + 1)
# Of the last action, the last kick, the game mode, and who has the ball.
_VALUES = (range(19), KICKS, range(7), (-1, 2, 0, 1))
_LABELS = np.array([label for label, values in enumerate(_VALUES) for _ in values])
_MEANINGS = np.array([value for values in _VALUES for value in values])


class Players(RawObservationTransform):
    """The match as the controlled player sees it, in numbers of about unit size.

    Writes ``players``, a float32 tensor of shape ``(*batch, 274)``; what each number is called and
    means is in :data:`~fbrl.transforms.players_table.PLAYERS_FEATURES`: what there is once, then
    ten team-mates and eleven opponents, each sorted by distance from the controlled player.

    Positions are relative to the controlled player, in multiples of 25 metres along the axes of the
    pitch; velocities in multiples of 5 m/s (10 m/s for the ball). Where nobody is controlled the
    ball stands in for the player. Who isn't there (fewer than eleven a side, or sent off) has zeros
    throughout, after those who are.

    It is computed on the CPU, wherever the observations are.

    Args:
        in_keys: where to find the raw observations and ``action_memory``, as
            :class:`ActionMemory` writes it before, in the order of :attr:`fields`.
        out_keys: where to write the vector.

    Raises:
        ValueError: if there are more or fewer keys than these.

    Examples:
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_empty_goal", num_envs=2, observation="players", seed=0)
        >>> state = env.reset()["players"]
        >>> state.shape
        torch.Size([2, 274])
        >>> numbers = dict(zip(PLAYERS_FEATURES, state[0].tolist()))
        >>> numbers["ball_is_free"], numbers["opponent_1_is_keeper"], numbers["opponent_2_is_there"]
        (1.0, 1.0, 0.0)
    """

    fields = (
        *(f"left_team{what}" for what in _OF_A_TEAM),
        *(f"right_team{what}" for what in _OF_A_TEAM),
        "ball",
        "ball_direction",
        "active",
        "designated",
        "ball_owned_team",
        "ball_owned_player",
        "game_mode",
        "score",
        "steps_left",
        "sticky_actions",
        "action_memory",
    )
    out_key = "players"

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns the vector (*batch, 274)."""
        shape, device = fields[-1].shape[:-1], fields[-1].device
        rows: Sequence[Tensor] = fields
        # Untouched where they are on the CPU with one leading dimension, as in a training.
        if device.type != "cpu":
            rows = [field.cpu() for field in rows]
        if len(shape) != 1:
            rows = [field.reshape(-1, *field.shape[len(shape) :]) for field in rows]
        arrays = dict(zip(self.fields, (row.numpy() for row in rows), strict=True))
        return torch.from_numpy(_players_features(arrays)).view(*shape, NUM_FEATURES).to(device)


def players_with_memory() -> Compose:
    """The observation ``players`` for an environment without an action memory."""
    return Compose(ActionMemory(), Players())


def _players_features(fields: Fields) -> NDArray[np.float32]:
    """The numbers, float32 (matches, 274), of raw entries with one leading dimension."""
    active = fields["active"]
    matches = np.arange(len(active))
    own = np.where(active < 0, _BALL, active)
    # Of all 22 players and the ball, in multiples of 25 metres, (matches, 23, 2).
    places = np.concatenate(
        [fields["left_team"], fields["right_team"], fields["ball"][:, None, :2]],
        axis=1,
        dtype=np.float32,
    )
    places *= _PLACE
    own_place = places[matches, own]
    is_there = np.concatenate([fields["left_team_active"], fields["right_team_active"]], -1) != 0
    # As ``AI_GetOffsideLine`` of the engine's ``AIfunctions.cpp`` draws it, (matches,).
    opponents = np.where(is_there[:, 11:], places[:, 11:_BALL, 0], -np.inf)
    last_but_one = np.partition(opponents, -2)[:, -2]
    line = np.maximum(np.maximum(last_but_one, places[:, _BALL, 0]), 0)
    rows = _player_rows(fields, places, own_place, line)

    numbers = np.empty((len(active), NUM_FEATURES), np.float32)
    _write_labels(numbers, fields)
    _write_own(numbers, fields, rows[matches, active], own_place, line)
    _write_ball(numbers, fields, places[:, _BALL], own_place)
    _write_goals(numbers, own_place)
    _write_game(numbers, fields)
    distance = np.full((len(active), _BALL + 1), np.inf, np.float32)
    np.copyto(distance[:, :_BALL], rows[..., 3], where=is_there)
    distance[matches, own] = np.inf
    mates, opponents = _nearest_first(rows, distance[:, :_BALL])
    numbers[:, MATES] = mates[:, :NUM_MATES].reshape(len(active), MATES.stop - MATES.start)
    opponents_shape = len(active), OPPONENTS.stop - OPPONENTS.start
    numbers[:, OPPONENTS] = opponents[..., :-1].reshape(opponents_shape)
    return numbers


def _player_rows(fields: Fields, places: Array, own_place: Array, line: Array) -> Array:
    """What is told of each player, shape (matches, 22, 10), also where nobody is."""
    rows = np.empty((len(places), _BALL, len(PLAYER_FEATURES)), np.float32)
    rows[..., 0] = 1
    np.subtract(places[:, :_BALL], own_place[:, None], out=rows[..., 1:3])
    np.hypot(rows[..., 1], rows[..., 2], out=rows[..., 3])
    for team, players in (("left_team", slice(11)), ("right_team", slice(11, None))):
        rows[:, players, 4:6] = fields[f"{team}_direction"]
        rows[:, players, 6] = fields[f"{team}_tired_factor"]
        rows[:, players, 7] = fields[f"{team}_roles"] == 0
    rows[..., 4:6] *= _PLAYER_VELOCITY
    owners = fields["ball_owned_team"]
    owner = np.where(owners < 0, -1, owners * 11 + fields["ball_owned_player"])
    rows[..., 8] = owner[:, None] == _PLAYERS
    rows[..., 9] = places[:, :_BALL, 0] > line[:, None]
    return rows


def _nearest_first(rows: Array, distance: Array) -> tuple[Array, Array]:
    """The rows of both teams, (matches, 11, 10) each, zeros for who is infinitely far away."""
    rows *= (distance < np.inf)[..., None]
    order = distance.reshape(-1, 11).argsort(-1, kind="stable")
    order += np.arange(0, order.size, 11)[:, None]
    ordered = rows.reshape(-1, rows.shape[-1]).take(order, 0).reshape(-1, 2, 11, rows.shape[-1])
    return ordered[:, 0], ordered[:, 1]


def _write_labels(numbers: Array, fields: Fields) -> None:
    numbers[:, : _ONE_HOTS.start] = fields["sticky_actions"]
    team = fields["ball_owned_team"]
    is_own = (team == 0) & (fields["ball_owned_player"] == fields["active"])
    memory = fields["action_memory"]
    labels = np.empty((len(team), len(_VALUES)), np.int64)
    labels[:, :2] = memory[:, :2]
    labels[:, 2] = fields["game_mode"]
    labels[:, 3] = np.where(is_own, 2, team)
    np.equal(labels.take(_LABELS, 1), _MEANINGS, out=numbers[:, _ONE_HOTS], casting="unsafe")


def _write_own(numbers: Array, fields: Fields, row: Array, place: Array, line: Array) -> None:
    column = _COLUMN["own_velocity_x"]
    is_controlled = fields["active"] >= 0
    np.multiply(row[:, 4:8], is_controlled[:, None], out=numbers[:, column : column + 4])
    numbers[:, column + 4 : column + 6] = place
    numbers[:, _COLUMN["is_controlled"]] = is_controlled
    is_designated = is_controlled & (fields["designated"] == fields["active"])
    numbers[:, _COLUMN["is_designated"]] = is_designated
    numbers[:, _COLUMN["offside_line"]] = line - place[:, 0]
    steps = fields["action_memory"][:, 2]
    numbers[:, _COLUMN["kick_may_wait"]] = steps <= KICK_WAITS_STEPS
    numbers[:, _COLUMN["steps_since_kick"]] = np.minimum(steps / KICK_WAITS_STEPS, 1)


def _write_ball(numbers: Array, fields: Fields, place: Array, own_place: Array) -> None:
    column = _COLUMN["ball_pitch_x"]
    relative = place - own_place
    distance = np.hypot(relative[:, 0], relative[:, 1])
    numbers[:, column : column + 2] = place
    numbers[:, column + 2 : column + 4] = relative
    numbers[:, column + 4] = distance
    numbers[:, column + 5] = 1 / (1 + distance * _METRES)
    numbers[:, column + 6] = fields["ball"][:, 2] / _HEIGHT
    numbers[:, column + 7 : column + 10] = fields["ball_direction"] * _BALL_VELOCITY


def _write_goals(numbers: Array, own_place: Array) -> None:
    column = _COLUMN["goal_x"]
    goal = numbers[:, column : column + 2]
    np.subtract(_GOAL, own_place, out=goal)
    x, y = goal.T
    distance = np.hypot(x, y)
    numbers[:, column + 2 : column + 4] = goal / np.maximum(distance, 1e-6)[:, None]
    # The angle between the vectors to the posts, from their outer and inner product.
    opening = np.arctan2(2 * _HALF_GOAL * x, distance**2 - _HALF_GOAL**2)
    numbers[:, column + 4] = opening / _OPENING
    numbers[:, column + 5] = distance
    numbers[:, column + 6] = np.hypot(_GOAL[0] + own_place[:, 0], own_place[:, 1])


def _write_game(numbers: Array, fields: Fields) -> None:
    score, steps = fields["score"], fields["steps_left"]
    column = _COLUMN["score_difference"]
    difference = np.maximum(np.minimum(score[:, 0] - score[:, 1], 3), -3)
    numbers[:, column] = difference / 3
    numbers[:, column + 1] = np.minimum(steps, 400) / 400
    numbers[:, column + 2] = steps / 3000
