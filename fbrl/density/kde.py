"""Gaussian kernel density estimation on the pitch: the exact sum and the bandwidth rules."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fbrl.density.coordinates import HALF_LENGTH, HALF_WIDTH, METRES_PER_UNIT

Array = NDArray[np.float64]
BandwidthRule = Literal["thesis", "scipy-silverman", "scipy-scott"]
"""Named rules; a number is accepted wherever a rule is."""

MIN_POINTS = 10
"""Fewer points than this say nothing about where goals are made."""

NARROWEST_BANDWIDTH, WIDEST_BANDWIDTH = 1e-6, 1000.0
"""Far finer than any position, and far wider than the pitch, in units or in metres."""

_QUERY_BLOCK = 4096


def check_points(points: ArrayLike, name: str = "points") -> Array:
    """Return the points as a float64 (n, 2) array, or say what is wrong with them.

    Raises:
        ValueError: on what is no array of numbers, a wrong shape, fewer than 10 points, points
            that are not on the pitch, or an axis without any spread.
    """
    try:
        xy = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} are no array of numbers ({error}).") from error
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise ValueError(f"{name} has shape {xy.shape}; expected (n, 2): x and y of each point.")
    if len(xy) < MIN_POINTS:
        raise ValueError(
            f"{name} holds {len(xy)} points; a density needs at least {MIN_POINTS}. "
            "Use a wider filter or more matches."
        )
    # A hair of tolerance: scaling a point on the touch line may round past it. NaN is beyond it.
    beyond = ~(np.abs(xy) <= np.array([HALF_LENGTH, HALF_WIDTH]) + 1e-9).all(axis=1)
    if beyond.any():
        row = int(beyond.argmax())
        raise ValueError(
            f"{name}[{row}] is {xy[row].tolist()}: not a finite position, or outside the pitch "
            f"[-1, 1] x [-0.42, 0.42] ({int(beyond.sum())} such rows). Scale StatsBomb's 120 x 80 "
            "positions with fbrl.density.pitch_from_statsbomb first, or drop these rows."
        )
    spread = xy.std(axis=0, ddof=1)
    if (spread < 1e-9).any():
        axis = "xy"[int(np.argmin(spread))]
        raise ValueError(
            f"{name} has zero variance in {axis}: all {len(xy)} points share one value, so no "
            "bandwidth can be derived. Give points that differ in both axes."
        )
    return xy


def kernel_covariance(
    points: Array, bandwidth: BandwidthRule | float = "thesis", *, metres: bool = False
) -> Array:
    r"""Covariance of the Gaussian kernel that a bandwidth rule gives, in pitch units.

    - ``"thesis"``: one isotropic :math:`h = (4\sigma^5 / 3n)^{1/5}` (thesis eq. 4.2), where
      :math:`\sigma` is the root mean square of the two axis standard deviations (``ddof=1``).
    - ``"scipy-silverman"`` and ``"scipy-scott"``: the sample covariance times the squared factor
      of :class:`scipy.stats.gaussian_kde`.
    - a number: that isotropic h.

    Args:
        points: (n, 2) positions in pitch units.
        bandwidth: one of the above.
        metres: an isotropic kernel is round in metres, and a number is in metres; otherwise both
            hold in pitch units, of which one is 54.4 m along x and 83.6 m along y. It makes no
            difference to scipy's rules, whose kernel follows the points.

    Raises:
        ValueError: for an unknown rule, or a number out of that range.
    """
    scale = np.array(METRES_PER_UNIT if metres else (1.0, 1.0))
    scaled = points * scale
    n = len(points)
    is_number = isinstance(bandwidth, (int, float)) and not isinstance(bandwidth, bool)
    if bandwidth == "thesis":
        sigma = float(np.sqrt(scaled.var(axis=0, ddof=1).mean()))
        covariance = (4.0 * sigma**5 / (3.0 * n)) ** 0.4 * np.eye(2)
    elif bandwidth in ("scipy-silverman", "scipy-scott"):
        # Silverman's factor is (n (d + 2) / 4)^(-1 / (d + 4)), which in two dimensions is Scott's.
        factor = n ** (-1.0 / 6.0)
        covariance = factor**2 * np.cov(scaled, rowvar=False, ddof=1)
    elif is_number and NARROWEST_BANDWIDTH <= float(bandwidth) <= WIDEST_BANDWIDTH:
        covariance = float(bandwidth) ** 2 * np.eye(2)
    else:
        allowed = ", ".join(repr(rule) for rule in get_args(BandwidthRule))
        raise ValueError(
            f"bandwidth is {bandwidth!r}; expected one of {allowed}, or a number from "
            f"{NARROWEST_BANDWIDTH:g} to {WIDEST_BANDWIDTH:g}."
        )
    return covariance / np.outer(scale, scale)


def equivalent_bandwidth(covariance: Array) -> float:
    """The isotropic bandwidth whose kernel covers the same area as this covariance."""
    return float(np.linalg.det(covariance) ** 0.25)


def kernel_sum(points: Array, queries: ArrayLike, covariance: Array) -> Array:
    r"""Exact Gaussian kernel density (thesis eq. 4.1).

    .. math::
        f(p) = \frac{1}{n \, 2\pi \sqrt{|C|}}
               \sum_i \exp\left(-\tfrac{1}{2} (p - p_i)^\top C^{-1} (p - p_i)\right)

    with :math:`C = h^2 I` for an isotropic bandwidth h.

    Args:
        points: (n, 2) sample positions.
        queries: (..., 2) positions to evaluate; the densities have the shape (...).
        covariance: (2, 2) kernel covariance, as :func:`kernel_covariance` gives it.
    """
    at = np.asarray(queries, dtype=np.float64)
    # In whitened coordinates every kernel is a unit Gaussian.
    whitening = np.linalg.inv(np.linalg.cholesky(covariance)).T
    samples = points @ whitening
    white = at.reshape(-1, 2) @ whitening
    total = np.empty(len(white))
    for first in range(0, len(white), _QUERY_BLOCK):
        block = slice(first, first + _QUERY_BLOCK)
        offset = white[block, None, :] - samples[None, :, :]
        total[block] = np.exp(-0.5 * np.square(offset).sum(axis=-1)).sum(axis=1)
    normaliser = len(points) * 2.0 * np.pi * np.sqrt(np.linalg.det(covariance))
    return (total / normaliser).reshape(at.shape[:-1])


def grid_positions(columns: int, rows: int) -> Array:
    """Node positions of a regular grid over the whole pitch, shape (columns, rows, 2)."""
    x = np.linspace(-HALF_LENGTH, HALF_LENGTH, columns)
    y = np.linspace(-HALF_WIDTH, HALF_WIDTH, rows)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
