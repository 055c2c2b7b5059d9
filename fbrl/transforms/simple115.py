"""gfootball's ``simple115v2`` vector."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from fbrl.transforms.raw_observation import RawObservationTransform


class Simple115(RawObservationTransform):
    """The match as 115 numbers: gfootball's ``simple115v2``.

    Writes ``simple115``, a float32 tensor of shape ``(*batch, 115)``:

    ======== ====================================================================
    0:22     positions of the left team, x and y of each player
    22:44    directions of the left team
    44:66    positions of the right team
    66:88    directions of the right team
    88:91    position of the ball
    91:94    direction of the ball
    94:97    who has the ball, one-hot: nobody, left, right
    97:108   the active player, one-hot; all zero where there is none
    108:115  game mode, one-hot
    ======== ====================================================================

    Players who aren't there keep the -1 that the raw observation pads them with. A NaN stays one,
    and a label that is none of those named leaves its columns zero.

    Args:
        in_keys: where to find the raw observations, in the order of :attr:`fields`.
        out_keys: where to write the vector.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> match = TensorDict(
        ...     left_team=torch.zeros(11, 2),
        ...     left_team_direction=torch.zeros(11, 2),
        ...     right_team=torch.full((11, 2), -1.0),
        ...     right_team_direction=torch.full((11, 2), -1.0),
        ...     ball=torch.tensor([0.5, 0.25, 0.125]),
        ...     ball_direction=torch.zeros(3),
        ...     ball_owned_team=torch.tensor(0),
        ...     active=torch.tensor(2),
        ...     game_mode=torch.tensor(6),
        ... )
        >>> Simple115()(match)["simple115"][88:].nonzero().flatten().add(88).tolist()
        [88, 89, 90, 95, 99, 114]
    """

    fields = (
        "left_team",
        "left_team_direction",
        "right_team",
        "right_team_direction",
        "ball",
        "ball_direction",
        "ball_owned_team",
        "active",
        "game_mode",
    )
    out_key = "simple115"

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns the vector (*batch, 115)."""
        *vectors, ball_owned_team, active, game_mode = fields
        source, meaning = _one_hot_columns(active.device)
        labels = torch.stack([ball_owned_team, active, game_mode], -1)
        one_hots = labels.index_select(-1, source) == meaning
        parts = [vector.flatten(active.ndim) for vector in vectors]
        return torch.cat([part.to(torch.float32) for part in (*parts, one_hots)], -1)


@lru_cache
def _one_hot_columns(device: torch.device) -> tuple[Tensor, Tensor]:
    """Which label each of the 21 one-hot columns reads, and the value it stands for."""
    values = [range(-1, 2), range(11), range(7)]
    source = [label for label, allowed in enumerate(values) for _ in allowed]
    meaning = [value for allowed in values for value in allowed]
    return torch.tensor(source, device=device), torch.tensor(meaning, device=device)
