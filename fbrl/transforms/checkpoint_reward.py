"""Google Research Football's checkpoint reward."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from tensordict import NestedKey
from torch import Tensor

from fbrl.transforms.ball_control import Observation, in_control
from fbrl.transforms.memory import Memory
from fbrl.transforms.shaped_reward import ShapedReward

NUM_CHECKPOINTS = 10
CHECKPOINT_REWARD = 0.1


class CheckpointReward(ShapedReward):
    r"""Pay for bringing the ball closer to the goal, as gfootball's ``CheckpointRewardWrapper``.

    There are ten checkpoints, the distances to the goal's centre (1, 0)
    :math:`d_k = 0.99 - \tfrac{0.8}{9} k,\ k = 0 \dots 9`. Each is worth 0.1, once per episode, and
    is collected when the controlled player has the ball at that distance or less. A goal
    (``reward == 1``) pays those not yet collected, so that every scored episode earns the same.

    Entries, each per match, are read as by :class:`~fbrl.transforms.AssistDensityReward`, but for
    ``game_mode``; a ball with a NaN coordinate collects nothing. Written under ``"next"``:

    - ``reward`` (..., 1): ``reward_scoring + reward_checkpoint``.
    - ``reward_scoring`` (..., 1): the reward that was read.
    - ``reward_checkpoint`` (..., 1) float32: 0 to 1, at most 1 over an episode.
    - ``checkpoints_collected`` (...) int64: 0 to 10. Also at the root: before the action.

    Stored data can be relabelled, see :meth:`forward`.

    Args:
        keys: as for :class:`~fbrl.transforms.AssistDensityReward`.

    Raises:
        ValueError: if one of them is not an entry of this transform.
        TypeError: if a name is neither a text nor a tuple.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from fbrl.transforms import CheckpointReward
        >>> state = {"ball": torch.tensor([0.5, 0.0, 0.0]), "ball_owned_team": torch.tensor(0),
        ...          "ball_owned_player": torch.tensor(3), "active": torch.tensor(3)}
        >>> step = TensorDict({"checkpoints_collected": torch.tensor(2),
        ...                    "next": {"reward": torch.zeros(1), **state}})
        >>> step = CheckpointReward()(step)  # at 0.5 from the goal: six checkpoints in all
        >>> step["next", "checkpoints_collected"], step["next", "reward"]
        (tensor(6), tensor([0.4000]))
    """

    _thresholds: Tensor

    def __init__(self, *, keys: Mapping[str, NestedKey | None] | None = None) -> None:
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active"),
            parts=("reward_checkpoint",),
            memory=("checkpoints_collected",),
            keys=keys,
        )
        # The order of operations and the precision are gfootball's.
        thresholds = [0.99 - 0.8 / (NUM_CHECKPOINTS - 1) * k for k in range(NUM_CHECKPOINTS)]
        self.register_buffer(
            "_thresholds", torch.tensor(thresholds, dtype=torch.float64), persistent=False
        )

    def _first_memory(self, observation: Observation) -> Memory:
        return {"checkpoints_collected": torch.zeros_like(observation["active"])}

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        ball = observation["ball"].to(torch.float64)
        distance = ((ball[..., 0] - 1.0) ** 2 + ball[..., 1] ** 2) ** 0.5
        reached = (distance.unsqueeze(-1) <= self._thresholds).sum(-1)
        before = memory["checkpoints_collected"]
        collected = torch.where(in_control(observation), torch.maximum(before, reached), before)
        return {"checkpoints_collected": collected.masked_fill(scoring == 1, NUM_CHECKPOINTS)}

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        newly = remembered["checkpoints_collected"] - memory["checkpoints_collected"]
        return (newly * CHECKPOINT_REWARD,)
