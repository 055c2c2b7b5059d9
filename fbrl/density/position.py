"""A density over the pitch that costs a few tensor operations to evaluate."""

from __future__ import annotations

import numbers
import sys
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from fbrl.density.coordinates import HALF_LENGTH, HALF_WIDTH


class PositionDensity(nn.Module):
    r"""A surface over the pitch :math:`[-1, 1] \times [-0.42, 0.42]`, bilinearly interpolated.

    The grid is divided by its maximum and multiplied by ``peak``, so that values lie in
    :math:`[0, peak]`. Positions outside the pitch, and positions with a NaN coordinate, have
    density 0.

    The state is one persistent buffer (``corners``), the peak and the number of rows. Nothing in
    :meth:`forward` depends on data in Python: it compiles, works under :func:`torch.vmap` and never
    waits for the device.

    Args:
        grid: (columns, rows) values at the nodes of a regular grid over the whole pitch, the first
            index along x. At least 2 x 2, finite, not negative, not all zero.
        peak: the value at the highest node. Positive and finite.

    Raises:
        TypeError: if the grid is no floating-point tensor, or the peak no number.
        ValueError: if they are out of range.

    Examples:
        >>> import torch
        >>> from fbrl.density import PositionDensity
        >>> grid = torch.zeros(3, 3)
        >>> grid[2, 1] = 8.0  # the middle of the right goal line
        >>> density = PositionDensity(grid, peak=0.1)
        >>> density(torch.tensor([[1.0, 0.0], [0.5, 0.0], [-1.0, 0.42], [1.1, 0.0]]))
        tensor([0.1000, 0.0500, 0.0000, 0.0000])
    """

    corners: Tensor
    _scale: Tensor
    _last: Tensor

    def __init__(self, grid: Tensor, peak: float = 1.0) -> None:
        super().__init__()
        normalised = _normalised_grid(grid)
        self.peak = _checked_peak(peak)
        columns, rows = normalised.shape
        self._rows = rows
        # One lookup per position instead of four: each node carries the values of the cell that
        # starts at it. The last column and row are repeated so that x = 1 and y = 0.42 have a cell.
        padded = functional.pad(normalised[None, None], (0, 1, 0, 1), mode="replicate")[0, 0]
        corners = torch.stack(
            [padded[:-1, :-1], padded[1:, :-1], padded[:-1, 1:], padded[1:, 1:]], dim=-1
        )
        self.register_buffer("corners", corners.reshape(columns * rows, 2, 2))
        # Shrunk by a hair, so that rounding never puts a ball on the touch line outside the pitch.
        reach = (1.0 - 1e-6) / 2.0
        scale = [reach * (columns - 1) / HALF_LENGTH, reach * (rows - 1) / HALF_WIDTH]
        last = [columns - 1.0, rows - 1.0]
        self.register_buffer("_scale", normalised.new_tensor(scale), persistent=False)
        self.register_buffer("_last", normalised.new_tensor(last), persistent=False)

    @property
    def grid(self) -> Tensor:
        """The node values, shape (columns, rows), with maximum 1."""
        return self.corners[:, 0, 0].reshape(-1, self._rows)

    def forward(self, position: Tensor) -> Tensor:
        """The density at floating-point positions of shape (..., 2), shape (...), in [0, peak].

        It has the wider of the position's and the grid's dtype.

        Raises:
            TypeError: if the position is no floating-point tensor.
            ValueError: if its last dimension is not 2.
        """
        if not isinstance(position, Tensor) or not position.is_floating_point():
            kind = getattr(position, "dtype", type(position).__name__)
            raise TypeError(f"position is {kind}; expected a floating-point tensor.")
        if position.shape[-1:] != (2,):
            raise ValueError(
                f"position has shape {tuple(position.shape)}; expected (..., 2): x and y."
            )
        # In units of cells; a NaN becomes a position outside the pitch, hence density 0.
        cells = torch.addcmul(self._last / 2.0, position, self._scale).nan_to_num(nan=-1.0)
        on_pitch = torch.minimum(cells.clamp_min(0.0), self._last)
        node = on_pitch.long()
        column, row = node.unbind(-1)
        along_x, along_y = (on_pitch - node).unbind(-1)
        corners = self.corners[torch.add(row, column, alpha=self._rows)].to(cells.dtype)
        edges = torch.lerp(corners[..., 0], corners[..., 1], along_x.unsqueeze(-1))
        value = torch.lerp(edges[..., 0], edges[..., 1], along_y)
        return value * (on_pitch == cells).all(-1) * self.peak

    def get_extra_state(self) -> dict[str, float]:
        """The peak and the number of rows, which a state dictionary holds beside the buffer."""
        return {"peak": self.peak, "rows": self._rows}

    def set_extra_state(self, state: Mapping[str, float]) -> None:
        """Takes the peak of a state.

        Raises:
            ValueError: if the state is that of a grid with another number of rows, or damaged.
        """
        if not isinstance(state, Mapping) or state.keys() != {"peak", "rows"}:
            raise ValueError(f"{state!r:.80} is no state of a PositionDensity.")
        if state["rows"] != self._rows:
            raise ValueError(
                f"The state is that of a grid with {state['rows']} rows, and this density has "
                f"{self._rows}: make one with a grid of that shape to load it."
            )
        self.peak = _checked_peak(state["peak"])

    def extra_repr(self) -> str:
        """Show the grid's size and the peak."""
        columns, rows = self.grid.shape
        return f"columns={columns}, rows={rows}, peak={self.peak}"


def _checked_peak(peak: float) -> float:
    if isinstance(peak, bool) or not isinstance(peak, numbers.Real):
        raise TypeError(f"peak is {peak!r}; it must be a number.")
    # An integer of Python may be larger than any other number.
    if not 0 < peak <= sys.float_info.max:
        raise ValueError(f"peak is {peak!r}; it must be a positive, finite number.")
    return float(peak)


def _normalised_grid(grid: Tensor) -> Tensor:
    if not isinstance(grid, Tensor):
        raise TypeError(f"grid is a {type(grid).__name__}; expected a floating-point tensor.")
    if grid.ndim != 2 or min(grid.shape) < 2:
        raise ValueError(
            f"grid has shape {tuple(grid.shape)}; expected (columns, rows), each at least 2."
        )
    if not grid.is_floating_point():
        raise TypeError(f"grid has dtype {grid.dtype}; expected a floating-point tensor.")
    if not bool(torch.isfinite(grid).all()):
        raise ValueError("grid contains NaN or infinite values; every node must be finite.")
    lowest, highest = float(grid.min()), float(grid.max())
    if lowest < 0:
        raise ValueError(f"grid contains a negative value ({lowest}); densities are not negative.")
    if highest == 0:
        raise ValueError("grid is all zero; it cannot be normalised by its maximum.")
    return grid.detach() / grid.detach().max()
