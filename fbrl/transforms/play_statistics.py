"""What happens in a match besides its reward: goals, possession, passes and shots."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from fbrl.density.pitch import METRES_PER_UNIT
from fbrl.transforms.ball_control import NOBODY, Observation, ball_lost, in_control, last_carrier
from fbrl.transforms.raw_observation import read_fields

__all__ = ["PLAY_STATISTICS", "PlayStatistics"]

PLAY_STATISTICS = (
    "goals_for",
    "goals_against",
    "possession",
    "opponent_possession",
    "passes",
    "shots",
)
"""Names of the totals, in their order."""

_FIELDS = (
    "ball",
    "ball_direction",
    "active",
    "ball_owned_team",
    "ball_owned_player",
    "game_mode",
)

# On 20,000 steps of scripted and built-in play, with shots told from passes by the action pressed,
# shots flew at 2 to 3.3 metres a step (100 ms) and passes at 1.2 to 2.1.
_SHOT_METRES_PER_STEP = 2.0
_SHOT_FROM_X = 0.4
# The posts stand at 0.044: a shot may miss them by 4.7 metres.
_SHOT_HALF_WIDTH = 0.1


class PlayStatistics(Transform):
    """Count an episode's goals, possession, passes and shots so far.

    ``play_statistics`` (..., 6) float32 holds the totals since the reset, named by
    :data:`PLAY_STATISTICS`; at an episode's last step they are the match's figures:

    - ``goals_for``, ``goals_against``: from ``reward_scoring``, so this transform comes after the
      reward;
    - ``possession``, ``opponent_possession``: steps after which a left (right) player had the ball;
    - ``passes``: the controlled player has the ball and the controlled player who had it last was
      another one, with no opponent's possession and no stop of the game in between: exactly what
      :class:`~fbrl.transforms.AssistDensityReward` takes for a transition;
    - ``shots``: the ball, last had by the left team or by nobody yet, flies freely at 20 m/s or
      more from the last 33 metres towards a point within 8.4 metres of the goal's centre; or a goal
      is scored without that. A flight counts once. What is seen is the flight, not the action, so
      that it works for every player, the engine's own too; slow shots that miss are not seen.

    ``play_memory`` (..., 2) int64 carries the last controlled player with the ball (-1 for none)
    and whether the ball is the left team's with no shot counted since it had it. Like a step
    counter's count both live in the tensordict, so that vectorised and partially reset environments
    work; a step needs what the previous step, or the reset, returned.

    It reads the raw keys ``ball``, ``ball_direction``, ``active``, ``ball_owned_team``,
    ``ball_owned_player`` and ``game_mode``.

    Examples:
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_empty_goal_close", num_envs=2, seed=0)
        >>> env.rollout(3)["next", "play_statistics"].shape
        torch.Size([2, 3, 6])
    """

    def __init__(self) -> None:
        super().__init__(in_keys=list(_FIELDS), out_keys=["play_statistics", "play_memory"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        observation = self._read(tensordict_reset)
        active = observation["active"]
        nobody = torch.full_like(active, NOBODY)
        # A ball that nobody has had yet may be shot at once, as in academy_empty_goal_close.
        is_ours = observation["ball_owned_team"] != 1
        memory = _remember(nobody, is_ours, in_control(observation), observation)
        totals = torch.zeros((*active.shape, len(PLAY_STATISTICS)), device=active.device)
        mask = tensordict.get("_reset", None)
        kept = tensordict.get("play_memory", None)
        if mask is not None and kept is not None:
            mask = mask.reshape(active.shape).unsqueeze(-1)
            memory = torch.where(mask, memory, kept)
            totals = torch.where(mask, totals, tensordict.get("play_statistics"))
        tensordict_reset.set("play_memory", memory)
        return tensordict_reset.set("play_statistics", totals)

    _reset_on_native_autoreset = _reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        totals, memory = tensordict.get("play_statistics", None), tensordict.get("play_memory")
        if totals is None:
            raise KeyError(
                "PlayStatistics found no 'play_statistics' in the tensordict that was stepped. "
                "Step what env.reset() or the previous step returned, with that entry kept."
            )
        observation = self._read(next_tensordict)
        active, team = observation["active"], observation["ball_owned_team"]
        in_play = observation["game_mode"] == 0
        scoring = next_tensordict.get("reward_scoring").squeeze(-1)
        carrier, is_ours = memory.unbind(-1)

        control = in_control(observation)
        passed = control & (carrier > NOBODY) & (carrier != active) & in_play
        free = (team == NOBODY) & in_play
        shot = (is_ours == 1) & ((free & _flies_at_goal(observation)) | (scoring > 0))
        happened = (scoring > 0, scoring < 0, team == 0, team == 1, passed, shot)
        next_tensordict.set("play_statistics", totals + torch.stack(happened, -1))

        remembered = _remember(carrier, (is_ours == 1) & ~shot, control, observation)
        return next_tensordict.set("play_memory", remembered)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Totals are counted step by step in an environment; there is nothing to do here."""
        return tensordict

    def _read(self, tensordict: TensorDictBase) -> Observation:
        fields = read_fields(tensordict, self.in_keys, _FIELDS, type(self).__name__)
        return dict(zip(_FIELDS, fields, strict=True))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the totals and the memory."""
        observation_spec.update(self._specs(observation_spec))
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Adds both to what a step needs, so that batched environments hand them on."""
        state_spec.update(self._specs(self.parent.full_observation_spec))
        return state_spec

    @staticmethod
    def _specs(observation_spec: Composite) -> dict[str, Unbounded]:
        shape, device = observation_spec["active"].shape, observation_spec.device
        if shape == (*observation_spec.shape, 1):
            shape = shape[:-1]
        return {
            "play_statistics": Unbounded((*shape, len(PLAY_STATISTICS)), device=device),
            "play_memory": Unbounded((*shape, 2), dtype=torch.int64, device=device),
        }


def _remember(
    carrier: Tensor, is_ours: Tensor, control: Tensor, observation: Observation
) -> Tensor:
    lost = ball_lost(observation)
    carrier = last_carrier(carrier, observation["active"], control, lost)
    is_ours = (is_ours | (observation["ball_owned_team"] == 0)) & ~lost
    return torch.stack((carrier, is_ours.long()), -1)


def _flies_at_goal(observation: Observation) -> Tensor:
    ball, direction = observation["ball"], observation["ball_direction"]
    x, y = ball[..., 0], ball[..., 1]
    dx, dy = direction[..., 0], direction[..., 1]
    speed = torch.hypot(dx * METRES_PER_UNIT[0], dy * METRES_PER_UNIT[1])
    # Where it crosses the goal line, multiplied by dx, which is positive.
    offset = y * dx + (1 - x) * dy
    towards = (dx > 0) & (offset.abs() <= _SHOT_HALF_WIDTH * dx)
    return towards & (x >= _SHOT_FROM_X) & (speed >= _SHOT_METRES_PER_STEP)
