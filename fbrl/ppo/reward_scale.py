"""The size of what a policy is paid, so that the critic learns equally well from any reward."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tensordict import TensorDictBase
from torchrl.objectives.value.functional import reward2go

_DECAY = 0.99
"""Of a batch's weight with each later one."""


class RewardScale:
    """The root mean square of discounted returns, averaged over the latest hundred batches or so.

    Divided by it, rewards of any size lead to returns of about 1, for which the learning rate, the
    norm of gradients and the weight of the critic's loss are made. It is what Stable-Baselines3's
    ``VecNormalize`` and OpenAI's Baselines do; rewards are not shifted, which would change what is
    best where episodes have different lengths.

    Args:
        gamma: Discount of a step.
    """

    def __init__(self, gamma: float) -> None:
        self._gamma = gamma
        self._square = 0.0
        self._weight = 0.0

    def update(self, batch: TensorDictBase) -> float:
        """Takes a batch in, and returns what its rewards are to be divided by.

        Args:
            batch: Shape (num_envs, num_steps), with ``reward`` and ``done`` under ``"next"``. What
                is paid after its end is not counted.
        """
        following = batch.get("next")
        returns = reward2go(following.get("reward"), following.get("done"), self._gamma)
        square = float(returns.double().square().mean())
        self._square = _DECAY * self._square + (1 - _DECAY) * square
        self._weight = _DECAY * self._weight + 1 - _DECAY
        return math.sqrt(self._square / self._weight) or 1.0

    def state_dict(self) -> dict[str, float]:
        """What later scales depend on."""
        return {"square": self._square, "weight": self._weight}

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Goes on from what :meth:`state_dict` returned."""
        self._square, self._weight = float(state["square"]), float(state["weight"])
