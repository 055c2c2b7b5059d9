"""The first convolution and pooling of the network on a CPU, computed where there are players.

At most 96 of the 110,592 inputs of a stacked Super Mini Map are set, so that nearly everywhere the
first convolution gives its bias, and the pooling that follows it too. Only the pixels next to a
marked cell are convolved, as one matrix product over their neighbourhoods, and only the windows
that contain such a pixel are pooled.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from fbrl.transforms.minimap_grid import (
    NUM_CELLS,
    SMM_HEIGHT,
    SMM_LAYERS,
    SMM_WIDTH,
    channels_of_cells,
)

__all__ = ["convolve_and_pool_cells"]

_KERNEL = 9
# A border of one pixel, so that every neighbourhood lies in the grid.
_PADDED_WIDTH = SMM_WIDTH + 2
_PADDED_HEIGHT = SMM_HEIGHT + 2
_POOLED_HEIGHT = SMM_HEIGHT // 2
_POOLED_WIDTH = SMM_WIDTH // 2
_NUM_WINDOWS = _POOLED_HEIGHT * _POOLED_WIDTH


def convolve_and_pool_cells(
    cells: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor
) -> torch.Tensor:
    """The same as drawing the cells as planes, a 3x3 convolution and a 3x3 pooling of stride 2.

    Values and gradients agree with ``max_pool_same(conv2d(cells_to_planes(cells), weight, bias,
    padding=1))`` up to the order of additions. The sizes of intermediate results depend on the
    data, which would make a GPU wait: it is meant for CPUs.

    Args:
        cells: int16, (batch, frames, 24), as :class:`fbrl.transforms.MiniMapCells` writes them.
        weight: (channels, 4 * frames, 3, 3).
        bias: (channels,).

    Returns:
        (batch, channels, 36, 48), with the channels innermost in memory.

    Raises:
        ValueError: A cell is beyond the grid's last one.

    Examples:
        >>> cells = torch.full((1, 4, 24), -1, dtype=torch.int16)
        >>> cells[0, 3, 22] = 36 * 96 + 48  # the ball in the centre, in the latest frame
        >>> pooled = convolve_and_pool_cells(cells, torch.ones(2, 16, 3, 3), torch.zeros(2))
        >>> pooled.shape, pooled[0, 0].nonzero().tolist()
        (torch.Size([1, 2, 36, 48]), [[17, 23], [17, 24], [18, 23], [18, 24]])
    """
    if cells.numel() and (highest := int(cells.max())) >= NUM_CELLS:
        raise ValueError(f"A cell is {highest}; cells must be in [-1, {NUM_CELLS - 1}].")
    pooled: torch.Tensor = _ConvolveAndPool.apply(cells, weight, bias)
    return pooled.view(-1, _POOLED_HEIGHT, _POOLED_WIDTH, len(bias)).permute(0, 3, 1, 2)


class _ConvolveAndPool(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, cells: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor
    ) -> torch.Tensor:
        neighbourhoods, windows, members = _find_windows(cells)
        neighbourhoods = neighbourhoods.to(weight.dtype)
        kernel = weight.permute(2, 3, 1, 0).reshape(-1, len(bias))
        # One row more than there are pixels next to a cell: it stands for all others.
        values = kernel.new_zeros(len(neighbourhoods) + 1, len(bias))
        torch.mm(neighbourhoods, kernel, out=values[:-1])
        candidates = values.index_select(0, members.flatten()).view(
            _KERNEL, len(windows), len(bias)
        )
        highest, winner = candidates.max(0)
        ctx.weight_shape = weight.shape
        ctx.save_for_backward(neighbourhoods, windows, members.t(), winner)
        pooled = bias.expand(len(cells) * _NUM_WINDOWS, -1).contiguous()
        return pooled.index_copy_(0, windows, highest.add_(bias))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        neighbourhoods, windows, members, winner = ctx.saved_tensors
        channels, *_ = ctx.weight_shape
        grad_values = grad.new_zeros(len(neighbourhoods) + 1, channels)
        grad_values.scatter_add_(0, members.gather(1, winner), grad.index_select(0, windows))
        grad_kernel = neighbourhoods.t() @ grad_values[:-1]
        grad_weight = grad_kernel.view(3, 3, -1, channels).permute(3, 2, 0, 1)
        return None, grad_weight, grad.sum(0)


def _find_windows(cells: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Finds the pixels next to a marked cell, and the pooling windows that contain one of them.

    Returns:
        The neighbourhoods of the pixels, uint8 of shape (pixels, 9 * channels); the windows as
        int64 of shape (windows,), numbered through the whole batch; and the rows of
        ``neighbourhoods`` that each window pools, int64 of shape (9, windows), where ``pixels``
        stands for a pixel with no cell next to it.
    """
    batch, frames, _ = cells.shape
    channels = frames * len(SMM_LAYERS)
    end = batch * _PADDED_HEIGHT * _PADDED_WIDTH
    around = _around(cells.device)

    # The upper left corner of each cell's neighbourhood; absent players are put behind the grids.
    cells = cells.long()
    first = torch.arange(0, end, _PADDED_HEIGHT * _PADDED_WIDTH, device=cells.device)
    corner = first[:, None, None] + cells + cells.div(SMM_WIDTH, rounding_mode="floor") * 2
    corner = torch.where(cells < 0, end, corner)
    size = end + 3 * _PADDED_WIDTH
    is_near = torch.zeros(size, dtype=torch.bool, device=cells.device)
    is_near.index_fill_(0, (corner.unsqueeze(-1) + around).flatten(), True)
    planes = torch.zeros(size * channels, dtype=torch.uint8, device=cells.device)
    marked = (corner + _PADDED_WIDTH + 1) * channels + channels_of_cells(frames, cells.device)
    planes.index_fill_(0, marked.flatten(), 1)

    grids = is_near[:end].view(batch, _PADDED_HEIGHT, _PADDED_WIDTH)[:, 1:-1, 1:-1]
    sample, row, column = grids.nonzero().unbind(1)
    num_pixels = len(sample)
    corner = (sample * _PADDED_HEIGHT + row) * _PADDED_WIDTH + column
    inside = (corner.unsqueeze(-1) + around).flatten()
    neighbourhoods = planes.view(size, channels).index_select(0, inside)
    neighbourhoods = neighbourhoods.view(num_pixels, _KERNEL * channels)

    # A pixel of an even row is in the windows that begin in it and two rows before; of an odd
    # row, in the one that begins in the row before.
    starts = [position.div(2, rounding_mode="floor") for position in (row, column)]
    earlier = [
        (position - 1).clamp_(min=0).div_(2, rounding_mode="floor") for position in (row, column)
    ]
    rows, columns = (torch.stack(pair) for pair in zip(starts, earlier, strict=True))
    is_touched = torch.zeros(batch * _NUM_WINDOWS, dtype=torch.bool, device=cells.device)
    window = (sample * _POOLED_HEIGHT + rows).mul_(_POOLED_WIDTH).unsqueeze(1) + columns
    is_touched.index_fill_(0, window.flatten(), True)
    windows = is_touched.nonzero().squeeze(1)

    pixel_at = torch.full((batch * NUM_CELLS,), num_pixels, dtype=torch.int32, device=cells.device)
    pixels = torch.arange(num_pixels, dtype=torch.int32, device=cells.device)
    pixel_at[sample * NUM_CELLS + row * SMM_WIDTH + column] = pixels
    grid = windows.div(_NUM_WINDOWS, rounding_mode="floor") * NUM_CELLS
    pooled = _pixels_of_windows(cells.device)[:, windows % _NUM_WINDOWS]
    members = pixel_at[pooled + grid].long()
    return neighbourhoods, windows, members


@lru_cache
def _around(device: torch.device) -> torch.Tensor:
    """The 9 pixels of a neighbourhood, counted from its upper left corner in the padded grid."""
    three = torch.arange(3, device=device)
    return (three.unsqueeze(-1) * _PADDED_WIDTH + three).flatten()


@lru_cache
def _pixels_of_windows(device: torch.device) -> torch.Tensor:
    """The 9 pixels that each window pools, (9, windows); past the last row, that row again."""
    three = torch.arange(3, device=device)
    rows = (torch.arange(0, SMM_HEIGHT, 2, device=device) + three[:, None]).clamp_(
        max=SMM_HEIGHT - 1
    )
    columns = (torch.arange(0, SMM_WIDTH, 2, device=device) + three[:, None]).clamp_(
        max=SMM_WIDTH - 1
    )
    pixels = rows[:, None, :, None] * SMM_WIDTH + columns[:, None, :]
    return pixels.reshape(_KERNEL, _NUM_WINDOWS)
