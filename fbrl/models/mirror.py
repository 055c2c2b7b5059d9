"""States seen from one side: mirrored along the pitch where the ball is in its upper half.

What is right to do in a state is right, mirrored, in the mirrored state: a network that sees only
states with the ball in the lower half (y >= 0) needs to learn half as much. The mirror is part of
the network, which has the direction that it chose mirrored back: all that is stored, logged and
played is as it was, and the ratios of PPO are exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from fbrl.envs.actions import ACTION_NAMES
from fbrl.transforms.minimap_grid import ABSENT, SMM_HEIGHT, SMM_LAYERS, SMM_WIDTH
from fbrl.transforms.players_table import PLAYERS_FEATURES

_SWAPPED = {"top": "bottom", "bottom": "top"}
_BALL_CELL = 22


def _mirrored_name(name: str) -> str:
    return "_".join(_SWAPPED.get(word, word) for word in name.split("_"))


MIRRORED_ACTIONS = tuple(ACTION_NAMES.index(_mirrored_name(name)) for name in ACTION_NAMES)
"""The action that each action becomes in a mirror along the pitch: top left for bottom left."""


class VectorMirror(nn.Module):
    """Mirrors a vector of numbers.

    Args:
        order: for each number, which one takes its place.
        is_y: for each number, whether its sign changes.
        ball_y: which one says on which side the ball is.
        padding: a number that stays as it is, since it stands for who isn't there.
    """

    order: Tensor
    sign: Tensor

    def __init__(
        self, order: Sequence[int], is_y: Sequence[bool], ball_y: int, padding: float | None = None
    ) -> None:
        super().__init__()
        sign = 1 - 2 * torch.tensor(is_y, dtype=torch.float32)
        self.register_buffer("order", torch.tensor(order), persistent=False)
        self.register_buffer("sign", sign, persistent=False)
        self.ball_y = ball_y
        self.padding = padding

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """What is seen, and whether it is mirrored, bool (...), from a vector (..., numbers)."""
        is_mirrored = observation[..., self.ball_y] < 0
        mirrored = observation.index_select(-1, self.order) * self.sign
        if self.padding is not None:
            mirrored = torch.where(observation == self.padding, observation, mirrored)
        return torch.where(is_mirrored.unsqueeze(-1), mirrored, observation), is_mirrored


class CellsMirror(nn.Module):
    """Mirrors the cells of :class:`~fbrl.transforms.MiniMapCells`, by the ball's last one.

    Who is exactly on the border of two rows comes to lie one row beside its mirror image.
    """

    def forward(self, cells: Tensor) -> tuple[Tensor, Tensor]:
        """What is seen, and whether it is mirrored, bool (...), from cells (..., frames, 24)."""
        ball = cells[..., -1, _BALL_CELL]
        is_mirrored = (ball != ABSENT) & (ball < SMM_HEIGHT // 2 * SMM_WIDTH)
        row = torch.div(cells, SMM_WIDTH, rounding_mode="floor")
        mirrored = cells + (SMM_HEIGHT - 1 - 2 * row) * SMM_WIDTH
        is_moved = is_mirrored[..., None, None] & (cells != ABSENT)
        return torch.where(is_moved, mirrored, cells), is_mirrored


class PlanesMirror(nn.Module):
    """Mirrors the planes of :class:`~fbrl.transforms.SuperMiniMap`, as :class:`CellsMirror`."""

    def forward(self, planes: Tensor) -> tuple[Tensor, Tensor]:
        """What is seen, and whether it is mirrored, bool (...), from planes (..., 16, 72, 96)."""
        ball = planes[..., SMM_LAYERS.index("ball") - len(SMM_LAYERS), : SMM_HEIGHT // 2, :]
        is_mirrored = (ball != 0).flatten(-2).any(-1)
        return torch.where(is_mirrored[..., None, None, None], planes.flip(-2), planes), is_mirrored


class PixelsMirror(nn.Module):
    """Mirrors the pictures of :class:`~fbrl.transforms.Pixels`, by where they show the ball.

    Those stay as they are in which the ball is beside the picture, or in the middle row of an odd
    height.
    """

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """What is seen, and whether it is mirrored, bool (...), from (..., 3, height, width)."""
        height = pictures.shape[-2]
        above_middle = height - 1 - 2 * torch.arange(height, device=pictures.device)
        # Nothing else is white.
        ball_in_row = (pictures == 255).all(-3).sum(-1)
        is_mirrored = (ball_in_row * above_middle).sum(-1) > 0
        mirrored = pictures.flip(-2)
        return torch.where(is_mirrored[..., None, None, None], mirrored, pictures), is_mirrored


class MirroredTrunk(nn.Module):
    """A trunk that sees every state with the ball in the lower half, through a mirror."""

    def __init__(self, trunk: nn.Module, mirror: nn.Module) -> None:
        super().__init__()
        self.trunk = trunk
        self.mirror = mirror

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """The features, and whether they are those of the mirrored state, bool (...)."""
        seen, is_mirrored = self.mirror(observation)
        return self.trunk(seen), is_mirrored


def _players_mirror() -> VectorMirror:
    names = list(PLAYERS_FEATURES)
    order = [names.index(_mirrored_name(name)) for name in names]
    is_y = [name.endswith("_y") for name in names]
    return VectorMirror(order, is_y, names.index("ball_pitch_y"))


def _simple115_mirror() -> VectorMirror:
    # Positions and directions of 22 players in pairs of x and y; x, y and z of the ball, twice.
    is_y = [column % 2 == 1 for column in range(88)] + [False, True, False] * 2 + [False] * 21
    return VectorMirror(range(115), is_y, 89, padding=-1.0)


MIRRORS: Mapping[str, Callable[[], nn.Module]] = {
    "minimap_cells": CellsMirror,
    "smm": PlanesMirror,
    "pixels": PixelsMirror,
    "simple115": _simple115_mirror,
    "players": _players_mirror,
}
"""What mirrors an observation, by the key that the network reads."""
