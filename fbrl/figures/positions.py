"""Tables of where an agent has had the ball, for :func:`fbrl.figures.pitch.agent_figure`."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from fbrl.files.csv_table import as_number, read_csv_table


def write_positions(path: str | os.PathLike[str], positions: NDArray[np.float64]) -> None:
    """Writes positions as a CSV table with the columns x and y in pitch units."""
    with open(path, "w", newline="") as file:
        np.savetxt(file, positions, "%.5f", ",", newline="\r\n", header="x,y", comments="")


def read_positions(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Reads positions from a CSV table with the columns x and y in pitch units.

    Returns:
        (n, 2) positions.

    Raises:
        ValueError: a column is missing, a value is no finite number, or there is no row.
        OSError: the file cannot be read.
    """
    table, rows = read_csv_table(path), []
    for line, row in zip(table.lines, table.rows, strict=True):
        try:
            rows.append((as_number(row["x"]), as_number(row["y"])))
        except (KeyError, ValueError) as error:
            raise ValueError(
                f"{path}, line {line}: no position ({type(error).__name__}: {error}). "
                "Expected the columns x and y in pitch units, [-1, 1] x [-0.42, 0.42]."
            ) from error
    positions = np.array(rows, dtype=np.float64).reshape(-1, 2)
    if not len(positions) or not np.isfinite(positions).all():
        raise ValueError(f"{path} holds no positions, or some that are not finite numbers.")
    return positions
