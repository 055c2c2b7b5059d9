"""Pitch control as what is seen, zones as what pays: a reading of Liu et al. (2023).

    cd experiments/learning
    fbrl-train academy_3_vs_1_with_keeper --observation pitch_control:PitchControl \
        --reward pitch_control:ZoneReward --network impala

"Learning to play football from sports domain perspective" (IEEE Transactions on Games 15 (4),
doi 10.1109/TG.2022.3207068) publishes neither formulas nor code. Its abstract has a state of the
space that each player, the team and the ball influence; the thesis adds that its reward has five
zones along the pitch, below zero near one's own goal, and signals for possession and dribbling. The
influence is that of Fernandez and Bornn (2018), "Wide open spaces"; every number of the reward, and
the network, are ours.
"""

from __future__ import annotations

import torch
from torch import Tensor

from fbrl.density.coordinates import METRES_PER_UNIT, PITCH_LENGTH, PITCH_WIDTH
from fbrl.transforms import Memory, Observation, RawObservationTransform, ShapedReward
from fbrl.transforms.ball_control import NOBODY, in_control

_STEPS_PER_SECOND = 10
_TOP_SPEED = 13.0  # m/s, at which the influence has no width
_BALL_RADIUS = 4.0  # metres


def influence(
    players: Tensor, velocities: Tensor, ball_distances: Tensor, points: Tensor
) -> Tensor:
    """How much of each point a player influences: 1 where he is, up to 4 where he runs to.

    A normal density around where he will be in half a second, stretched along his run, narrower
    the nearer he is to the ball, divided by its value where he is (Fernandez and Bornn 2018,
    appendix).

    Args:
        players: (..., players, 2), metres.
        velocities: (..., players, 2), metres per second.
        ball_distances: (..., players), metres.
        points: (points, 2), metres.

    Returns:
        (..., players, points).
    """
    radius = (4 + ball_distances**3 / 972).clamp(max=10)
    speed = velocities.norm(dim=-1)
    ratio = (speed / _TOP_SPEED).square().clamp(max=0.99)
    along, across = radius * (1 + ratio) / 2, radius * (1 - ratio) / 2
    angle = torch.atan2(velocities[..., 1], velocities[..., 0])
    cosine, sine = angle.cos()[..., None], angle.sin()[..., None]

    def exponent(offsets: Tensor) -> Tensor:
        x, y = offsets.unbind(-1)
        forward, sideways = x * cosine + y * sine, y * cosine - x * sine
        return ((forward / along[..., None]) ** 2 + (sideways / across[..., None]) ** 2) / 2

    middle = players + velocities / 2
    from_middle = exponent(points - middle[..., None, :])
    return (exponent((players - middle)[..., None, :]) - from_middle).exp()


class PitchControl(RawObservationTransform):
    """Draw who controls which part of the pitch.

    Writes ``pitch_control``, uint8 (..., 3, height, width) from 0 to 255: how much of a place the
    own team controls (128: neither does), how much the controlled player influences it, in shares
    of where he does most, and how near the ball is.

    Args:
        height: Of the picture, along the goal lines.
        width: Likewise, along the touch lines.
    """

    fields = (
        *("left_team", "left_team_direction", "left_team_active"),
        *("right_team", "right_team_direction", "right_team_active"),
        *("ball", "active"),
    )
    out_key = "pitch_control"

    def __init__(self, height: int = 24, width: int = 36) -> None:
        super().__init__()
        self.height, self.width = height, width

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns the picture, uint8 (..., 3, height, width)."""
        seen = dict(zip(self.fields, fields, strict=True))
        metres = torch.tensor(METRES_PER_UNIT, device=seen["ball"].device)
        players, directions, is_there = (
            torch.cat([seen[f"{team}{name}"] for team in ("left_team", "right_team")], dim)
            for name, dim in (("", -2), ("_direction", -2), ("_active", -1))
        )
        ball = seen["ball"][..., :2] * metres
        places, points = players * metres, self._points(ball.device)
        distances = (places - ball[..., None, :]).norm(dim=-1)
        each = influence(places, directions * metres * _STEPS_PER_SECOND, distances, points)
        each = each * is_there[..., None]
        left, right = each[..., :11, :].sum(-2), each[..., 11:, :].sum(-2)
        index = seen["active"].long().clamp(min=0)[..., None, None]
        own = each.gather(-2, index.expand(*index.shape[:-1], len(points))).squeeze(-2)
        own = own / own.amax(-1, keepdim=True).clamp(min=1)
        near = (-(points - ball[..., None, :]).square().sum(-1) / (2 * _BALL_RADIUS**2)).exp()
        planes = torch.stack([torch.sigmoid(left - right), own, near], -2)
        picture = (planes * 255).round().to(torch.uint8)
        return picture.unflatten(-1, (self.height, self.width))

    def _points(self, device: torch.device) -> Tensor:
        """The middle of each pixel, (height * width, 2), metres."""
        rows, columns = (
            ((torch.arange(number, device=device) + 0.5) / number - 0.5) * metres
            for number, metres in ((self.height, PITCH_WIDTH), (self.width, PITCH_LENGTH))
        )
        return torch.cartesian_prod(rows, columns).flip(-1)


class ZoneReward(ShapedReward):
    """Pay for the ball's fifth of the pitch, for having it, and for running forward with it.

    Writes ``reward_zone``, ``reward_possession`` and ``reward_dribbling``, float32 (..., 1), under
    ``"next"``. Zones and possession pay in each step, and so can be farmed.

    Args:
        zone: What a step is worth with the ball in the second fifth from their goal; twice that in
            the last one, as much less than nothing in our second, twice in our last.
        possession: What a step is worth with the ball at the own team, and costs at the other's.
        dribbling: What ten metres are worth that the controlled player runs forward with it, and
            cost backwards.
    """

    def __init__(
        self, zone: float = 0.001, possession: float = 0.001, dribbling: float = 0.02
    ) -> None:
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active"),
            parts=("reward_zone", "reward_possession", "reward_dribbling"),
            memory=("carrier", "carried_from"),
        )
        self.zone, self.possession, self.dribbling = zone, possession, dribbling

    def _first_memory(self, observation: Observation) -> Memory:
        player = observation["ball_owned_player"]
        return {
            "carrier": player.masked_fill(~in_control(observation), NOBODY),
            "carried_from": observation["ball"][..., 0].clone(),
        }

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        return self._first_memory(observation)

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        x, team = observation["ball"][..., 0], observation["ball_owned_team"]
        fifth = ((x + 1) / 0.4).floor().clamp(0, 4) - 2
        carrier = remembered["carrier"]
        runs = (carrier != NOBODY) & (carrier == memory["carrier"])
        metres = (x - memory["carried_from"]) * METRES_PER_UNIT[0]
        return (
            self.zone * fifth,
            self.possession * ((team == 0).float() - (team == 1).float()),
            self.dribbling / 10 * metres * runs,
        )
