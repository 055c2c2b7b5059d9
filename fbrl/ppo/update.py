"""One gradient step of PPO on a minibatch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torch.optim import Optimizer
from torchrl.objectives import ClipPPOLoss

_REMEDY = "the training has diverged. Try a lower learning_rate or clip_epsilon."


class TrainingDivergedError(ArithmeticError):
    """Raised before a step that would put infinities or NaNs into the network.

    Args:
        message: What is not finite, and what to try.
        minibatch: What the step was to be taken on.
        losses: Its losses and the norm of their gradient, as far as they were computed.
    """

    def __init__(
        self, message: str, minibatch: TensorDictBase, losses: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.minibatch = minibatch
        self.losses = dict(losses or {})


def minibatches(batch: TensorDictBase, steps_per_minibatch: int) -> Iterator[TensorDictBase]:
    """Splits a flat batch at random into minibatches of one size; a remainder is left out.

    Args:
        batch: Shape (steps,).
        steps_per_minibatch: Size of each minibatch.
    """
    steps = batch.shape[0]
    order = torch.randperm(steps, device=batch.device)
    whole = steps - steps % steps_per_minibatch
    for index in order[:whole].split(steps_per_minibatch):
        yield batch[index]


def update(
    loss_module: ClipPPOLoss,
    optimizer: Optimizer,
    minibatch: TensorDictBase,
    max_grad_norm: float,
) -> TensorDictBase:
    """Takes one step down the gradient of the clipped surrogate, the critic and the entropy loss.

    Args:
        loss_module: The loss, over the parameters that the optimizer holds.
        optimizer: Takes the step.
        minibatch: Shape (steps,) with the observation, ``action``, ``action_log_prob``,
            ``advantage`` and ``value_target``.
        max_grad_norm: The gradient is scaled down to this norm.

    Returns:
        Scalars on the minibatch's device:
        ``policy_loss``, ``value_loss``, ``entropy``, ``approx_kl``, ``clip_fraction`` and
        ``gradient_norm`` (before scaling).

    Raises:
        TrainingDivergedError: The loss or its gradient is not finite; the parameters are as they
            were before.
    """
    try:
        losses = loss_module(minibatch)
    except RuntimeError as error:
        # For logits that are not finite the loss estimates the entropy by sampling, which fails.
        if "probability tensor" not in str(error):
            raise
        message = f"The policy is no longer finite: {_REMEDY}"
        raise TrainingDivergedError(message, minibatch) from error
    loss = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    gradient_norm = nn.utils.clip_grad_norm_(parameters, max_grad_norm)
    # Waits for the device, as the loss does anyway when it checks the entropy.
    if not torch.isfinite(loss + gradient_norm):
        raise TrainingDivergedError(
            f"The loss is {loss.item():g}, the norm of its gradient {gradient_norm.item():g}: "
            f"{_REMEDY}",
            minibatch,
            {
                "policy_loss": losses["loss_objective"].item(),
                "value_loss": losses["loss_critic"].item(),
                "entropy_loss": losses["loss_entropy"].item(),
                "gradient_norm": gradient_norm.item(),
            },
        )
    optimizer.step()
    return TensorDict(
        {
            "policy_loss": losses["loss_objective"].detach(),
            "value_loss": losses["loss_critic"].detach(),
            "entropy": losses["entropy"],
            "approx_kl": losses["kl_approx"],
            "clip_fraction": losses["clip_fraction"],
            "gradient_norm": gradient_norm,
        }
    )
