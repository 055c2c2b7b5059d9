"""The grid of the Super Mini Map: which cell a point lies in, and cells drawn as planes."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

SMM_WIDTH = 96
SMM_HEIGHT = 72
NUM_CELLS = SMM_HEIGHT * SMM_WIDTH
SMM_LAYERS = ("left_team", "right_team", "ball", "active")
CELLS_PER_FRAME = 24
ABSENT = -1
"""Cell index of a player who isn't there."""

_LAYER_OF_CELL = (0,) * 11 + (1,) * 11 + (2, 3)


def frame_cells(
    left_team: Tensor,
    right_team: Tensor,
    ball: Tensor,
    active: Tensor,
    left_team_roles: Tensor,
    right_team_roles: Tensor,
) -> Tensor:
    """Finds the cells that gfootball's ``generate_smm`` marks for one frame.

    Args:
        left_team: positions, floating point ``(*batch, 11, 2)``. Outside the grid they count as its
            nearest cell; who is at a NaN position isn't there.
        right_team: likewise.
        ball: its position, ``(*batch, 3)``.
        active: index of the active player in the left team, or -1 for none, ``(*batch,)``.
        left_team_roles: ``(*batch, 11)``, where -1 marks a player who isn't there.
        right_team_roles: likewise.

    Returns:
        int16 ``(*batch, 24)``: the cells of the left and right players, the ball and the active
        player, as :class:`~fbrl.transforms.MiniMapCells` writes them.

    Raises:
        ValueError: if ``active`` is neither -1 nor an index of the left team; on a GPU a device's
            error instead.
    """
    low, extent, size, last = _grid(ball.device)
    points = torch.cat([left_team, right_team, ball[..., None, :2]], -2)
    # gfootball computes with Python's 64-bit floats; 32 bits round points onto the next cell.
    columns_rows = ((points.double() - low) / extent * size).clamp_(min=last.new_zeros(2), max=last)
    columns_rows = columns_rows.floor_()
    cells = torch.add(columns_rows[..., 0], columns_rows[..., 1], alpha=SMM_WIDTH)
    cells = cells.nan_to_num_(nan=ABSENT).to(torch.int16)
    absent = torch.cat([left_team_roles, right_team_roles], -1) < 0
    cells[..., :22].masked_fill_(absent, ABSENT)
    # An active player of -1 reads the first entry.
    candidates = torch.nn.functional.pad(cells[..., :11], (1, 0), value=ABSENT)
    try:
        active_cell = candidates.gather(-1, active.long().unsqueeze(-1) + 1)
    except RuntimeError as error:
        if "out of bounds" not in str(error):
            raise
        raise ValueError(f"active is {active.tolist()}; it must be in [-1, 10].") from error
    return torch.cat([cells, active_cell], -1)


def cells_to_planes(
    cells: Tensor, dtype: torch.dtype = torch.uint8, *, channels_last: bool = False
) -> Tensor:
    """Draws minimap cells as planes, on the device of the cells.

    Args:
        cells: int16 of shape ``(*batch, frames, 24)``, as :class:`MiniMapCells` writes them.
        dtype: of the planes. A marked cell is 255 in uint8, and 1 in floating point.
        channels_last: whether the channels lie innermost in memory. The shape stays the same.

    Returns:
        Planes of shape ``(*batch, frames * 4, 72, 96)``.

    Raises:
        ValueError: if they are of another shape or dtype; on a CPU, if one is above 6911, which a
            GPU would have to wait for.

    Examples:
        >>> cells = torch.full((2, 4, 24), -1, dtype=torch.int16)
        >>> cells[..., 23] = 95
        >>> planes = cells_to_planes(cells, torch.float32, channels_last=True)
        >>> planes.shape, planes[:, 3, 0, 95].tolist(), planes.sum().item()
        (torch.Size([2, 16, 72, 96]), [1.0, 1.0], 8.0)
    """
    if not isinstance(cells, Tensor):
        raise ValueError(
            f"cells_to_planes: cells are a {type(cells).__name__}, but must be a tensor."
        )
    if cells.ndim < 2 or cells.shape[-1] != CELLS_PER_FRAME or cells.dtype != torch.int16:
        raise ValueError(
            f"cells_to_planes: cells are {cells.dtype} of shape {tuple(cells.shape)}, but must be "
            f"torch.int16 of shape (*batch, frames, {CELLS_PER_FRAME}). MiniMapCells makes them."
        )
    if cells.device.type == "cpu" and cells.numel() and (highest := int(cells.max())) >= NUM_CELLS:
        raise ValueError(f"A cell is {highest}; cells must be in [-1, {NUM_CELLS - 1}].")
    batch, frames = cells.shape[:-2], cells.shape[-2]
    channels = frames * len(SMM_LAYERS)
    size = batch.numel() * channels * NUM_CELLS
    flat_cells = cells.reshape(-1, frames, CELLS_PER_FRAME)
    sample = torch.arange(batch.numel(), device=cells.device)[:, None, None]
    channel = _channels(frames, cells.device)
    if channels_last:
        index = (sample * NUM_CELLS + flat_cells) * channels + channel
    else:
        index = (sample * channels + channel) * NUM_CELLS + flat_cells
    # One element more than the planes need: absent players are drawn there, not masked out, so
    # that the number of indices doesn't depend on the data, which would make a GPU wait.
    index = torch.where(flat_cells < 0, size, index)
    planes = torch.zeros(size + 1, dtype=dtype, device=cells.device)
    planes.index_fill_(0, index.flatten(), 1 if dtype.is_floating_point else 255)
    if channels_last:
        return planes[:size].view(*batch, SMM_HEIGHT, SMM_WIDTH, channels).movedim(-1, -3)
    return planes[:size].view(*batch, channels, SMM_HEIGHT, SMM_WIDTH)


@lru_cache
def _grid(device: torch.device) -> tuple[Tensor, ...]:
    # As tensors on the device, since a GPU divides by a Python number through its reciprocal.
    half_height = 1.0 / 2.25
    low, extent = [-1.0, -half_height], [2.0, 2 * half_height]
    size, last = [SMM_WIDTH, SMM_HEIGHT], [SMM_WIDTH - 1, SMM_HEIGHT - 1]
    rows = torch.tensor([low, extent, size, last], dtype=torch.float64, device=device)
    return rows.unbind()


@lru_cache
def _channels(frames: int, device: torch.device) -> Tensor:
    """The channel that each cell is drawn in, shape (frames, 24)."""
    layers = torch.tensor(_LAYER_OF_CELL, device=device)
    return torch.arange(frames, device=device)[:, None] * len(SMM_LAYERS) + layers
