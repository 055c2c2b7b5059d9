"""PARIS, a public learner for 11 against 11, as an observation, a reward and a network.

    cd experiments/learning
    fbrl-train academy_3_vs_1_with_keeper --observation paris:ParisFeatures \
        --reward paris:ParisReward --network paris:ParisNetwork --mask expert

After seungeunrho/football-paris, restated: ``encoder_basic.py``, ``rewarder_basic.py`` and
``conv1d.py``. Left out are its LSTM, since PPO here learns from single steps; the heads, of which
one is for directions, with a layer of their own; and its rules for our goal kicks, corners and
penalties. Shots are not available with the ball behind the goal line, where PARIS allows them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from fbrl.envs import ACTION_NAMES
from fbrl.transforms import (
    ExpertActionMask,
    Memory,
    Observation,
    RawObservationTransform,
    ShapedReward,
)

_MIDDLE_X, _BOX_X, _BOX_Y, _END_Y = 0.2, 0.64, 0.27, 0.42
_ZONE_PAY = (-2.0, -1.0, 0.0, 2.0, 1.0, 0.0)
_FAR = 0.03
_CARDS = ("left_team_yellow_card", "right_team_yellow_card")

_PLAYER, _BALL, _OTHER, _NUM_MATES, _NUM_OPPONENTS = 29, 18, 7, 10, 11
_SIZES = (_PLAYER, _BALL, _NUM_MATES * _OTHER, _OTHER, _NUM_OPPONENTS * _OTHER, _OTHER)

_NON_MOVEMENT = slice(ACTION_NAMES.index("long_pass"), None)
_SHORT_PASS, _SPRINT, _DRIBBLE = map(ACTION_NAMES.index, ("short_pass", "sprint", "dribble"))


def zone_of(ball: Tensor) -> Tensor:
    """PARIS's zones of the pitch: own box, own third, middle, their box, their third, elsewhere.

    Args:
        ball: (..., 2 or more), x and y first.

    Returns:
        int64 (...), 0 to 5.
    """
    x, y = ball[..., 0], ball[..., 1].abs()
    on_pitch = (x.abs() <= 1) & (y < _END_Y)
    zone = torch.where(x < -_MIDDLE_X, 1, torch.where(x <= _MIDDLE_X, 2, 4))
    zone = zone.masked_fill((x < -_BOX_X) & (y < _BOX_Y), 0)
    zone = zone.masked_fill((x > _BOX_X) & (y < _BOX_Y), 3)
    return zone.masked_fill(~on_pitch, 5)


class ParisFeatures(RawObservationTransform):
    """What PARIS sees: 29 numbers of the player, 18 of the ball, 7 of each other player.

    Writes ``paris``, float32 (..., 208): player, ball, ten team-mates, the nearest of them once
    more, eleven opponents, the nearest of them once more. Who isn't there, in scenarios with fewer
    than eleven a side, is told of as the environment pads him, which PARIS never met.
    """

    fields = (
        "left_team",
        "left_team_direction",
        "left_team_tired_factor",
        "left_team_roles",
        "right_team",
        "right_team_direction",
        "right_team_tired_factor",
        "ball",
        "ball_direction",
        "ball_owned_team",
        "active",
        "game_mode",
        "sticky_actions",
    )
    out_key = "paris"

    def __init__(self) -> None:
        super().__init__()
        self._available = ExpertActionMask()

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns the numbers, float32 (..., 208)."""
        seen = dict(zip(self.fields, fields, strict=True))
        active = seen["active"].long().clamp(min=0)
        numbers = torch.arange(_NUM_MATES, device=active.device)
        mates = numbers + (numbers >= active[..., None])
        own = {
            name: _players(seen[f"left_team{name}"], active[..., None])
            for name in ("", "_direction", "_tired_factor", "_roles")
        }
        groups = [self._player(seen, own), self._ball(seen, own[""])]
        for team, chosen in (("left_team", mates), ("right_team", None)):
            rows = _others(seen, team, chosen, own[""])
            nearest = rows[..., 5].argmin(-1, keepdim=True)
            groups += [rows.flatten(-2), _players(rows, nearest).flatten(-2)]
        return torch.cat(groups, -1)

    def _player(self, seen: Observation, own: Observation) -> Tensor:
        available = self._available.compute(*(seen[name] for name in self._available.fields))
        # PARIS lets sprint and dribble be chosen again while they are held.
        available[..., _SPRINT], available[..., _DRIBBLE] = True, available[..., _SHORT_PASS]
        place, direction = own[""].squeeze(-2), own["_direction"].squeeze(-2) * 100
        roles = torch.arange(10, device=place.device)
        is_far = (seen["ball"][..., :2] - place).norm(dim=-1, keepdim=True) > _FAR
        held = seen["sticky_actions"]
        return torch.cat(
            [
                available[..., _NON_MOVEMENT].to(place.dtype),
                place,
                direction,
                direction.norm(dim=-1, keepdim=True),
                (own["_roles"] == roles).to(place.dtype),
                is_far.to(place.dtype),
                own["_tired_factor"],
                held[..., 9:].to(place.dtype),
                held[..., 8:9].to(place.dtype),
            ],
            -1,
        )

    def _ball(self, seen: Observation, own_place: Tensor) -> Tensor:
        ball, direction = seen["ball"], seen["ball_direction"] * 20
        relative = ball[..., :2] - own_place.squeeze(-2)
        team = seen["ball_owned_team"][..., None]
        zones = torch.arange(len(_ZONE_PAY), device=ball.device)
        return torch.cat(
            [
                ball,
                (zone_of(ball)[..., None] == zones).to(ball.dtype),
                relative,
                direction,
                direction[..., :2].norm(dim=-1, keepdim=True),
                relative.norm(dim=-1, keepdim=True),
                (team != -1).to(ball.dtype),
                (team == 0).to(ball.dtype),
            ],
            -1,
        )


def _players(values: Tensor, numbers: Tensor) -> Tensor:
    """Of n players by their numbers (..., n): what (..., players) or (..., players, k) has."""
    if values.ndim == numbers.ndim:
        return values.gather(-1, numbers)
    index = numbers[..., None].expand(*numbers.shape, values.shape[-1])
    return values.gather(-2, index)


def _others(seen: Observation, team: str, chosen: Tensor | None, own_place: Tensor) -> Tensor:
    """Seven numbers of each: place x 2, direction x 100, speed x 100, distance x 2, tiredness."""
    names = (team, f"{team}_direction", f"{team}_tired_factor")
    values = [seen[name] if chosen is None else _players(seen[name], chosen) for name in names]
    place, direction, tired = values[0], values[1] * 100, values[2]
    distance = (place - own_place).norm(dim=-1, keepdim=True)
    speed = direction.norm(dim=-1, keepdim=True)
    return torch.cat([place * 2, direction, speed, distance * 2, tired[..., None]], -1)


class ParisReward(ShapedReward):
    """Pay 5 for a goal, 5 for a win at the time limit, for yellow cards, and the ball's zone.

    Writes ``reward_goal``, ``reward_win``, ``reward_zone`` and ``reward_card``, float32 (..., 1),
    under ``"next"``. The zone pays in each step, whoever has the ball, and so can be farmed.

    Args:
        goal: What a goal is worth.
        win: What having scored more is worth when the time is over.
        zone: What a step is worth with the ball in the second best zone; twice that in their box,
            as much less than nothing in our third, twice in our box.
        card: What a yellow card of theirs is worth, and of ours costs.
    """

    def __init__(
        self, goal: float = 5.0, win: float = 5.0, zone: float = 0.003, card: float = 1.0
    ) -> None:
        super().__init__(
            observations=("ball", "score", "steps_left", *_CARDS),
            parts=("reward_goal", "reward_win", "reward_zone", "reward_card"),
            memory=("score_difference", "card_difference"),
        )
        self.goal, self.win, self.zone, self.card = goal, win, zone, card

    def _first_memory(self, observation: Observation) -> Memory:
        left, right = (observation[cards].sum(-1) for cards in _CARDS)
        score = observation["score"]
        return {"score_difference": score[..., 0] - score[..., 1], "card_difference": right - left}

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        return self._first_memory(observation)

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        ahead = remembered["score_difference"]
        goals = ahead - memory["score_difference"]
        cards = remembered["card_difference"] - memory["card_difference"]
        pay = torch.tensor(_ZONE_PAY, device=ahead.device)
        return (
            (self.goal - 1) * goals,  # the scoring reward pays the first
            self.win * ((observation["steps_left"] == 0) & (ahead > 0)),
            self.zone * pay[zone_of(observation["ball"])],
            self.card * cards,
        )


class ParisNetwork(nn.Module):
    """PARIS's network without its LSTM: a layer for each group, a convolution over players.

    Args:
        observation_shape: Of what is read; only (208,), that of :class:`ParisFeatures`.
        num_features: Of its last layer.

    Raises:
        ValueError: The observation has another shape.
    """

    def __init__(self, observation_shape: Sequence[int] = (208,), num_features: int = 256) -> None:
        super().__init__()
        if tuple(observation_shape) != (sum(_SIZES),):
            raise ValueError(
                f"The observation has shape {tuple(observation_shape)}; ParisNetwork reads that of "
                f"ParisFeatures, ({sum(_SIZES)},)."
            )
        self.num_features = num_features
        player, ball = _normed(_PLAYER, 64), _normed(_BALL, 64)
        mates, nearest_mate = _Team(_NUM_MATES), _normed(_OTHER, 48)
        opponents, nearest_opponent = _Team(_NUM_OPPONENTS), _normed(_OTHER, 48)
        self.groups = nn.ModuleList(
            [player, ball, mates, nearest_mate, opponents, nearest_opponent]
        )
        self.together = _normed(2 * (64 + 96 + 48), num_features)

    def forward(self, observation: Tensor) -> Tensor:
        """Maps (..., 208) to (..., num_features)."""
        groups = observation.split(_SIZES, -1)
        embedded = [layer(group) for layer, group in zip(self.groups, groups, strict=True)]
        return self.together(torch.cat(embedded, -1)).relu()


class _Team(nn.Module):
    def __init__(self, num_players: int) -> None:
        super().__init__()
        # A convolution of width 1 over the players is a layer for each of them.
        self.of_player = nn.Sequential(_normed(_OTHER, 48), nn.Linear(48, 36), nn.ReLU())
        self.of_team = nn.Sequential(_normed(num_players * 36, 96), nn.ReLU())
        self._num_players = num_players

    def forward(self, players: Tensor) -> Tensor:
        rows = players.unflatten(-1, (self._num_players, _OTHER))
        return self.of_team(self.of_player(rows).flatten(-2))


def _normed(num_inputs: int, num_outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(num_inputs, num_outputs), nn.LayerNorm(num_outputs))
