"""Fit densities to the positions of passes.

``fbrl-density fit`` does it from a command line. The densities that fbrl ships were made with::

    fbrl-density fit --csv open_play_assists.csv --out open_play_assists_2015_16.npz
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike

from fbrl.density.assist import AssistDensity, DensityMetadata
from fbrl.density.coordinates import HALF_LENGTH, HALF_WIDTH
from fbrl.density.kde import (
    Array,
    BandwidthRule,
    check_points,
    equivalent_bandwidth,
    grid_positions,
    kernel_covariance,
    kernel_sum,
)
from fbrl.density.position import PositionDensity

PEAK_START = 0.001
PEAK_END = 0.1
MAX_INTERPOLATION_ERROR = 0.005
"""What bilinear interpolation may cost, as a fraction of the peak."""

COARSEST_GRID = 3
FINEST_GRID = 1001
"""Bounds on the grid nodes along x."""


class PositionFit(NamedTuple):
    """One fitted density, with the bandwidth and error that its metadata gives."""

    density: PositionDensity
    bandwidth: float
    max_interpolation_error: float


def fit_position_density(
    points: ArrayLike,
    *,
    peak: float,
    bandwidth: BandwidthRule | float = "thesis",
    metres: bool = False,
    mirror: bool = False,
    columns: int | None = None,
    name: str = "points",
) -> PositionFit:
    """Fit one density on the environment's pitch.

    Args:
        points: (n, 2) positions in pitch units.
        peak: the density's largest value.
        bandwidth: see :func:`fbrl.density.kde.kernel_covariance`.
        metres: likewise.
        mirror: average the surface with its left-right mirror image. The bandwidth stays that of
            the points: mirror images tell nothing new.
        columns: grid nodes along x, from 3 to 1001; the nodes along y follow from the same
            spacing. ``None`` takes the coarsest of a few grids whose interpolation error is at
            most 0.5 % of the peak.
        name: what error messages call the points.

    Raises:
        ValueError: if the points make no density (see :func:`fbrl.density.kde.check_points`), the
            bandwidth is none, or no grid is fine enough for it.
        TypeError: if columns is no integer, or peak no number.
    """
    xy = check_points(points, name)
    covariance = kernel_covariance(xy, bandwidth, metres=metres)
    h = equivalent_bandwidth(covariance)
    if columns is not None:
        if isinstance(columns, bool) or not isinstance(columns, int):
            raise TypeError(f"columns is {columns!r}; it must be an integer.")
        if not COARSEST_GRID <= columns <= FINEST_GRID:
            raise ValueError(
                f"columns is {columns}; it must be from {COARSEST_GRID} to {FINEST_GRID}."
            )
        density, error = _gridded(xy, covariance, columns, peak, mirror)
        return PositionFit(density, h, error)
    narrowest = math.sqrt(float(np.linalg.eigvalsh(covariance)[0]))
    columns = min(FINEST_GRID, math.ceil(4 * 2 * HALF_LENGTH / narrowest) + 1)
    while True:
        density, error = _gridded(xy, covariance, columns, peak, mirror)
        if error <= MAX_INTERPOLATION_ERROR:
            return PositionFit(density, h, error)
        if columns >= FINEST_GRID:
            raise ValueError(
                f"bandwidth {h:.4g} for {name} is too narrow for a grid: with {columns} columns "
                f"the interpolation error is still {error:.1%} of the peak. Use a wider bandwidth."
            )
        columns = min(FINEST_GRID, math.ceil(1.2 * columns))


def _gridded(
    points: Array, covariance: Array, columns: int, peak: float, mirror: bool
) -> tuple[PositionDensity, float]:
    rows = round((columns - 1) * HALF_WIDTH / HALF_LENGTH) + 1
    # Every second node of the finer lattice is a node; the others are the middles of cells and
    # edges, where bilinear interpolation is furthest off.
    lattice = grid_positions(2 * columns - 1, 2 * rows - 1)
    exact = kernel_sum(points, lattice, covariance)
    if mirror:
        exact = (exact + exact[:, ::-1]) / 2.0
    grid = exact[::2, ::2]
    density = PositionDensity(torch.from_numpy(grid.astype(np.float32)), peak)
    interpolated = density(torch.from_numpy(lattice)).numpy() / peak
    return density, float(np.abs(interpolated - exact / grid.max()).max())


def fit_assist_density(
    starts: ArrayLike,
    ends: ArrayLike,
    *,
    source: str,
    filter: str = "all given",
    credit: str = "",
    bandwidth: BandwidthRule | float = "thesis",
    peak_start: float = PEAK_START,
    peak_end: float = PEAK_END,
    columns: int | None = None,
    metres: bool = False,
    mirror: bool = False,
    counts: Mapping[str, int] | None = None,
) -> AssistDensity:
    """Fit the start and the end density of a set of assists.

    Args:
        starts: (n, 2) positions in pitch units that the assists were played from.
        ends: (n, 2) positions that they were received at.
        source: where they come from, such as competitions and seasons, for the metadata.
        filter: which passes these are, for the metadata.
        credit: the credit that the data's owner asks for ("Data: StatsBomb"), for the metadata.
        bandwidth: see :func:`fit_position_density`.
        peak_start: the start density's largest value.
        peak_end: the end density's largest value.
        columns: see :func:`fit_position_density`.
        metres: see :func:`fit_position_density`.
        mirror: see :func:`fit_position_density`.
        counts: how many passes there are of each competition and season, for the metadata.

    Raises:
        ValueError: see :func:`fit_position_density`.

    Examples:
        >>> import numpy as np
        >>> rng = np.random.default_rng(0)
        >>> starts, ends = rng.normal([[[0.4, 0.0]], [[0.8, 0.0]]], 0.05, (2, 200, 2))
        >>> density = fit_assist_density(starts, ends, source="made up", columns=101)
        >>> density.metadata.n
        200
    """
    starts, ends = check_points(starts, "starts"), check_points(ends, "ends")
    if len(starts) != len(ends):
        raise ValueError(f"{len(starts)} starts but {len(ends)} ends; each assist needs both.")
    fit = functools.partial(
        fit_position_density, bandwidth=bandwidth, metres=metres, mirror=mirror, columns=columns
    )
    start = fit(starts, peak=peak_start, name="starts")
    end = fit(ends, peak=peak_end, name="ends")
    metadata = DensityMetadata(
        source=source,
        filter=filter,
        n=len(starts),
        bandwidth_rule=str(bandwidth),
        bandwidth_start=start.bandwidth,
        bandwidth_end=end.bandwidth,
        max_interpolation_error=max(start.max_interpolation_error, end.max_interpolation_error),
        credit=credit,
        counts=dict(counts or {}),
        metres=metres,
        mirror=mirror,
    )
    return AssistDensity(start.density, end.density, metadata)
