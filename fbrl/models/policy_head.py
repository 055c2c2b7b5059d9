"""The last layer of the policy: logits of the actions, mirrored and masked where that is asked."""

from __future__ import annotations

import torch
from torch import nn

from fbrl.models.mirror import MIRRORED_ACTIONS

__all__ = ["MASKED_LOGIT", "PolicyHead"]

MASKED_LOGIT = -1e9
"""The logit of a masked action: its probability is exactly 0.

Not minus infinity, with which the entropy's gradient would be no number.
"""


class PolicyHead(nn.Linear):
    """A linear layer from features to the logits of discrete actions.

    With masked logits the usual ``Categorical`` has the probabilities, the entropy and the
    log-probabilities of a categorical distribution over the actions that are left, like
    ``torchrl.modules.MaskedCategorical``, at no further cost.

    Args:
        num_features: size of the features.
        num_actions: number of discrete actions.
        device: where the parameters live.

    Examples:
        >>> import torch
        >>> mask = torch.tensor([True] * 18 + [False])
        >>> logits = PolicyHead(8, 19)(torch.zeros(8), action_mask=mask)
        >>> logits.softmax(-1)[18].item()
        0.0
    """

    mirrored_actions: torch.Tensor

    def __init__(
        self, num_features: int, num_actions: int, device: torch.device | str | None = None
    ) -> None:
        super().__init__(num_features, num_actions, device=device)
        order = torch.tensor(MIRRORED_ACTIONS, device=device)
        self.register_buffer("mirrored_actions", order, persistent=False)

    def forward(
        self,
        hidden: torch.Tensor,
        mirrored: torch.Tensor | None = None,
        action_mask: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Maps (..., num_features) to (..., num_actions).

        Args:
            hidden: the features.
            mirrored: bool (...,), where the features are those of the mirrored state: the logits
                are those of the mirrored actions there. Only for gfootball's 19 actions.
            action_mask: bool (..., num_actions), false for an action that must not be chosen. In a
                row without any true one all are equally probable.
        """
        logits = super().forward(hidden)
        if mirrored is not None:
            back = logits.index_select(-1, self.mirrored_actions)
            logits = torch.where(mirrored.unsqueeze(-1), back, logits)
        if action_mask is not None:
            logits = logits.masked_fill(~action_mask, MASKED_LOGIT)
        return logits
