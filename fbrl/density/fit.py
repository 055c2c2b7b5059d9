"""Fit a pair of densities to a table of assists.

The densities that fbrl ships were made with::

    python -m fbrl.density.fit open_play_assists.csv open_play_assists_2015_16.npz \
        --source "Premier League 2015/16 and Ligue 1 2015/16" \
        --filter "goal assists with play pattern Regular Play"

The table needs the columns x, y, end_x and end_y on StatsBomb's 120 x 80 pitch.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fbrl.density.assist import AssistDensity, DensityMetadata
from fbrl.density.kde import (
    BandwidthRule,
    check_points,
    equivalent_bandwidth,
    grid_positions,
    kernel_covariance,
    kernel_sum,
)
from fbrl.density.pitch import HALF_LENGTH, HALF_WIDTH, pitch_from_statsbomb
from fbrl.density.position import PositionDensity

PEAK_START = 0.001
PEAK_END = 0.1
MAX_INTERPOLATION_ERROR = 0.005
"""What bilinear interpolation may cost, as a fraction of the peak."""

_COLUMNS = ("x", "y", "end_x", "end_y")
_FINEST_GRID = 1001


class PositionFit(NamedTuple):
    """One fitted density.

    Attributes:
        density: the gridded density.
        bandwidth: the kernel's (equivalent) isotropic bandwidth in pitch units.
        max_interpolation_error: the grid's largest difference from the exact kernel sum, as a
            fraction of the peak.
    """

    density: PositionDensity
    bandwidth: float
    max_interpolation_error: float


def fit_position_density(
    points: ArrayLike,
    *,
    peak: float,
    bandwidth: BandwidthRule | float = "thesis",
    columns: int | None = None,
    name: str = "points",
) -> PositionFit:
    """Fit one density on the environment's pitch.

    Args:
        points: (n, 2) positions in pitch units.
        peak: the density's largest value.
        bandwidth: see :func:`fbrl.density.kde.kernel_covariance`.
        columns: grid nodes along x; the nodes along y follow from the same spacing. ``None``
            takes the coarsest of a few grids whose interpolation error is at most 0.5 % of the
            peak.
        name: what error messages call the points.
    """
    xy = check_points(points, name)
    covariance = kernel_covariance(xy, bandwidth)
    h = equivalent_bandwidth(covariance)
    if columns is not None:
        density, error = _gridded(xy, covariance, columns, peak)
        return PositionFit(density, h, error)
    narrowest = math.sqrt(float(np.linalg.eigvalsh(covariance)[0]))
    columns = min(_FINEST_GRID, math.ceil(4 * 2 * HALF_LENGTH / narrowest) + 1)
    while True:
        density, error = _gridded(xy, covariance, columns, peak)
        if error <= MAX_INTERPOLATION_ERROR:
            return PositionFit(density, h, error)
        if columns >= _FINEST_GRID:
            raise ValueError(
                f"bandwidth {h:.4g} for {name} is too narrow for a grid: with {columns} columns "
                f"the interpolation error is still {error:.1%} of the peak. Use a wider bandwidth."
            )
        columns = min(_FINEST_GRID, math.ceil(1.2 * columns))


def _gridded(
    points: NDArray[np.float64], covariance: NDArray[np.float64], columns: int, peak: float
) -> tuple[PositionDensity, float]:
    rows = round((columns - 1) * HALF_WIDTH / HALF_LENGTH) + 1
    # Every second node of the finer lattice is a node; the others are the middles of cells and
    # edges, where bilinear interpolation is furthest off.
    lattice = grid_positions(2 * columns - 1, 2 * rows - 1)
    exact = kernel_sum(points, lattice, covariance)
    grid = exact[::2, ::2]
    density = PositionDensity(torch.from_numpy(grid.astype(np.float32)), peak)
    interpolated = density(torch.from_numpy(lattice)).numpy() / peak
    return density, float(np.abs(interpolated - exact / grid.max()).max())


def fit_assist_density(
    starts: ArrayLike,
    ends: ArrayLike,
    *,
    source: str,
    filter: str,
    credit: str = "Data: StatsBomb",
    bandwidth: BandwidthRule | float = "thesis",
    peak_start: float = PEAK_START,
    peak_end: float = PEAK_END,
    columns: int | None = None,
) -> AssistDensity:
    """Fit the start and the end density of a set of assists.

    Args:
        starts: (n, 2) positions in pitch units that the assists were played from.
        ends: (n, 2) positions that they were received at.
        source: competitions and seasons, for the metadata.
        filter: which passes these are, for the metadata.
        credit: the credit that the data's owner asks for, for the metadata.
        bandwidth: see :func:`fbrl.density.kde.kernel_covariance`.
        peak_start: the start density's largest value.
        peak_end: the end density's largest value.
        columns: see :func:`fit_position_density`.

    Examples:
        >>> import numpy as np
        >>> rng = np.random.default_rng(0)
        >>> starts, ends = rng.normal([[[0.4, 0.0]], [[0.8, 0.0]]], 0.05, (2, 200, 2))
        >>> density = fit_assist_density(
        ...     starts, ends, source="made up", filter="none", credit="", columns=101
        ... )
        >>> density.metadata.n
        200
    """
    if len(np.asarray(starts)) != len(np.asarray(ends)):
        raise ValueError(
            f"{len(np.asarray(starts))} starts but {len(np.asarray(ends))} ends; "
            "each assist needs both."
        )
    start = fit_position_density(
        starts, peak=peak_start, bandwidth=bandwidth, columns=columns, name="starts"
    )
    end = fit_position_density(
        ends, peak=peak_end, bandwidth=bandwidth, columns=columns, name="ends"
    )
    metadata = DensityMetadata(
        source=source,
        filter=filter,
        n=len(np.asarray(starts)),
        bandwidth_rule=str(bandwidth),
        bandwidth_start=start.bandwidth,
        bandwidth_end=end.bandwidth,
        max_interpolation_error=max(start.max_interpolation_error, end.max_interpolation_error),
        credit=credit,
    )
    return AssistDensity(start.density, end.density, metadata)


def read_assists_csv(
    path: str | os.PathLike[str],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read pass starts and ends from a table on StatsBomb's 120 x 80 pitch.

    Args:
        path: a CSV file with the columns x, y, end_x and end_y; others are ignored.

    Returns:
        Starts and ends in the environment's pitch units, each (n, 2).

    Raises:
        ValueError: if a column is missing or a value is not a number.
    """
    with Path(path).open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        header = reader.fieldnames or []
        missing = [column for column in _COLUMNS if column not in header]
        if missing:
            raise ValueError(
                f"{path} lacks the columns {missing}; it has {list(header)}. "
                "Expected x, y, end_x and end_y on the 120 x 80 pitch."
            )
        passes = [
            [_number(row, column, path, reader.line_num) for column in _COLUMNS] for row in reader
        ]
    table = np.array(passes, dtype=np.float64).reshape(-1, 4)
    return pitch_from_statsbomb(table[:, :2]), pitch_from_statsbomb(table[:, 2:])


def _number(row: dict[str, str], column: str, path: str | os.PathLike[str], line: int) -> float:
    try:
        return float(row[column])
    except (TypeError, ValueError):
        raise ValueError(
            f"{path}, line {line}: {column} is {row[column]!r}, not a number. "
            "Fill it in or drop the row."
        ) from None


def main(arguments: list[str] | None = None) -> int:
    """Fit a density file from a table and print what came out."""
    parser = argparse.ArgumentParser(
        prog="python -m fbrl.density.fit",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("csv", help="table with x, y, end_x, end_y on the 120 x 80 pitch")
    parser.add_argument("out", help="density file to write")
    parser.add_argument("--source", required=True, help="competitions and seasons")
    parser.add_argument("--filter", required=True, help="which passes the table holds")
    options = parser.parse_args(arguments)
    try:
        starts, ends = read_assists_csv(options.csv)
        density = fit_assist_density(starts, ends, source=options.source, filter=options.filter)
        density.save(options.out)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{options.out}: {density.metadata}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
