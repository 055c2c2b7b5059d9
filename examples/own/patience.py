"""An action mask of your own: fbrl-train SCENARIO --mask patience:NoLongShots."""

import torch
from torch import Tensor

from fbrl.envs import ACTION_NAMES
from fbrl.transforms import RawObservationTransform


class NoLongShots(RawObservationTransform):
    """Mask shots from afar.

    Args:
        from_x: How far forward the ball has to be; their goal is at 1.
    """

    fields = ("ball",)
    out_key = "action_mask"

    def __init__(self, from_x: float = 0.5) -> None:
        super().__init__()
        self.from_x = from_x

    def compute(self, ball: Tensor) -> Tensor:
        """Writes which of the actions may be chosen, bool (..., 19)."""
        mask = torch.ones(*ball.shape[:-1], len(ACTION_NAMES), dtype=torch.bool)
        mask[..., ACTION_NAMES.index("shot")] = ball[..., 0] >= self.from_x
        return mask
