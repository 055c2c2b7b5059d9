"""Advantages of a collected batch, with the state values that collection has already computed."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives.value import GAE


@torch.no_grad()
def add_next_state_value(batch: TensorDictBase, value_operator: TensorDictModuleBase) -> None:
    """Writes ``("next", "state_value")`` without evaluating a state twice.

    Inside an episode the value of the next state is that of the following step, which the
    collection policy has stored. Only where the time limit cut an episode off, and at the end of
    the batch, is there a state that no action was chosen in; its value is computed here. After a
    terminal state it is 0.

    Args:
        batch: Shape (num_envs, num_steps) with ``state_value`` (num_envs, num_steps, 1), the
            observation under ``"next"`` and the flags ``("next", "done")`` and
            ``("next", "terminated")``.
        value_operator: Maps the observation to ``state_value``; it may be on another device than
            the batch, and only those last states are moved to it.
    """
    state_value = batch.get("state_value")
    following = batch.get("next")
    next_value = torch.zeros_like(state_value)
    next_value[:, :-1] = state_value[:, 1:]
    unknown = following.get("done").clone()
    unknown[:, -1] = True
    next_value.masked_fill_(unknown, 0.0)
    unknown &= ~following.get("terminated")
    index = unknown.squeeze(-1).nonzero(as_tuple=True)
    cut_off = following.select(*value_operator.in_keys)[index]
    device = next((p.device for p in value_operator.parameters()), state_value.device)
    next_value[index] = value_operator(cut_off.to(device)).get("state_value").to(state_value.device)
    following.set("state_value", next_value)


@torch.no_grad()
def add_advantages(
    batch: TensorDictBase,
    value_operator: TensorDictModuleBase,
    *,
    gamma: float,
    gae_lambda: float,
    reward_scale: float = 1.0,
) -> None:
    """Writes ``advantage`` and ``value_target``: generalised advantage estimation.

    An episode that the time limit cut off is bootstrapped with the value of its last state, one
    that a rule ended is not (Schulman et al. 2016; Pardo et al. 2018 on time limits).

    Args:
        batch: As for :func:`add_next_state_value`, with ``("next", "reward")``.
        value_operator: Maps the observation to ``state_value``.
        gamma: Discount of a step.
        gae_lambda: Decay of the estimator.
        reward_scale: What the rewards are divided by first; values are in this unit.
    """
    add_next_state_value(batch, value_operator)
    estimator = GAE(
        gamma=gamma, lmbda=gae_lambda, value_network=None, device=batch.get("state_value").device
    )
    following = batch.get("next")
    following.set("scaled_reward", following.get("reward") / reward_scale)
    estimator.set_keys(reward="scaled_reward")
    estimator(batch, time_dim=1)


def explained_variance(batch: TensorDictBase) -> torch.Tensor:
    """1 - Var(target - value) / Var(target): 1 for a perfect critic, 0 for a useless one.

    Args:
        batch: With ``state_value`` and ``value_target``.

    Returns:
        A scalar tensor; not a number where all targets are equal.
    """
    target, value = batch.get("value_target"), batch.get("state_value")
    return 1 - (target - value).var() / target.var()
