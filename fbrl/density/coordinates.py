"""The two coordinate systems: the environment's pitch and StatsBomb's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

HALF_LENGTH = 1.0
"""Goal lines lie at x = -1 and x = +1."""

HALF_WIDTH = 0.42
"""Touch lines lie at y = -0.42 and y = +0.42."""

METRES_PER_UNIT = (54.4, 83.6)
"""How long one unit of x and of y is in the environment's physics."""

PITCH_LENGTH = 2 * HALF_LENGTH * METRES_PER_UNIT[0]
"""From goal line to goal line, metres."""

PITCH_WIDTH = 2 * HALF_WIDTH * METRES_PER_UNIT[1]
"""From touch line to touch line, metres."""

STATSBOMB_LENGTH = 120.0
STATSBOMB_WIDTH = 80.0


def pitch_from_statsbomb(points: ArrayLike) -> NDArray[np.float64]:
    """Scale StatsBomb's 120 x 80 pitch to the environment's.

    The attacking direction is +x and y grows downwards from the top in both.

    Args:
        points: (..., 2) x and y on StatsBomb's pitch.

    Raises:
        ValueError: if they are no numbers, or of another shape.

    Examples:
        >>> pitch_from_statsbomb([[120.0, 40.0], [0.0, 80.0]])
        array([[ 1.  ,  0.  ],
               [-1.  ,  0.42]])
    """
    try:
        xy = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"points are no array of numbers ({error}).") from error
    if xy.ndim == 0 or xy.shape[-1] != 2:
        raise ValueError(
            f"points has shape {xy.shape}; the last dimension must be 2: "
            "x and y on the 120 x 80 pitch."
        )
    half = np.array([HALF_LENGTH, HALF_WIDTH])
    return (xy / np.array([STATSBOMB_LENGTH, STATSBOMB_WIDTH]) * 2.0 - 1.0) * half
