"""An observation of your own: fbrl-train SCENARIO --observation nearest:NearestPlayers."""

import torch
from torch import Tensor

from fbrl.transforms import RawObservationTransform


class NearestPlayers(RawObservationTransform):
    """Where the ball, the goal and the nearest players are, seen from the controlled player.

    Args:
        num_players: How many of each team.
    """

    fields = ("left_team", "right_team", "ball", "active")
    out_key = "nearest_players"

    def __init__(self, num_players: int = 4) -> None:
        super().__init__()
        self.num_players = num_players

    def compute(self, left: Tensor, right: Tensor, ball: Tensor, active: Tensor) -> Tensor:
        """Writes (..., 4 + 4 * num_players) numbers."""
        me = torch.take_along_dim(left, active.long().clamp(min=0)[..., None, None], -2)
        seen = [torch.stack([ball[..., :2], torch.tensor([1.0, 0.0]).expand_as(ball[..., :2])], -2)]
        for team in (left, right):
            nearest = (team - me).norm(dim=-1, keepdim=True).argsort(-2)[..., : self.num_players, :]
            seen.append(torch.take_along_dim(team, nearest, -2))
        return (torch.cat(seen, -2) - me).flatten(-2)
