"""Policies without a network, to compare agents with."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from fbrl.checks import check_count, check_name
from fbrl.envs.engine import BUILTIN_AI, NUM_ACTIONS
from fbrl.envs.vector_env import ActionSet
from fbrl.policy_names import POLICIES


class RandomPolicy(TensorDictModuleBase):
    """Takes each of gfootball's 19 actions equally often, from PyTorch's global generator."""

    action_set: ActionSet = "default"
    in_keys: list[str] = []  # noqa: RUF012 (the base class's type)
    out_keys = ["action"]  # noqa: RUF012

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds ``action``, int64 of the batch's shape."""
        action = torch.randint(NUM_ACTIONS, tensordict.batch_size, device=tensordict.device)
        return tensordict.set("action", action)


class ConstantPolicy(TensorDictModuleBase):
    """Always takes the same action.

    Args:
        action: In [0, 19]; 19 lets the engine's own player decide, for which the environment needs
            the :attr:`action_set` ``"v2"``.

    Raises:
        ValueError: The action is out of range.
        TypeError: It is no integer.
    """

    in_keys: list[str] = []  # noqa: RUF012 (the base class's type)
    out_keys = ["action"]  # noqa: RUF012

    def __init__(self, action: int) -> None:
        super().__init__()
        if check_count("action", action, at_least=0) > BUILTIN_AI:
            raise ValueError(f"action is {action}; it must be in [0, {BUILTIN_AI}].")
        self.action = action
        self.action_set: ActionSet = "v2" if action == BUILTIN_AI else "default"

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds ``action``, int64 of the batch's shape."""
        shape, device = tensordict.batch_size, tensordict.device
        return tensordict.set("action", torch.full(shape, self.action, device=device))


def make_policy(name: str) -> RandomPolicy | ConstantPolicy:
    """A policy from its name.

    Args:
        name: ``"random"``, ``"idle"`` (no action, what was held is kept up) or ``"builtin-ai"``
            (the engine's own player).

    Raises:
        UnknownNameError: There is none of this name.

    Examples:
        >>> from fbrl.envs import make_env
        >>> policy = make_policy("builtin-ai")
        >>> env = make_env("academy_empty_goal", num_envs=2, action_set=policy.action_set, seed=0)
        >>> env.rollout(3, policy)["action"].unique()
        tensor([19])
    """
    check_name("policy", name, POLICIES)
    if name == "random":
        return RandomPolicy()
    return ConstantPolicy(0 if name == "idle" else BUILTIN_AI)
