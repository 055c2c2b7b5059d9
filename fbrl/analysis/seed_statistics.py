"""Statistics over seeds, with the intervals that a handful of runs allows.

Source of the interquartile mean, the probability of improvement and the stratified bootstrap:
Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice".

With few seeds every percentile bootstrap is too narrow: the 95 % intervals for the mean of normally
distributed scores hold it over 2 seeds in 50 of 100 cases, over 3 in 75, over 5 in 84, over 10 in
91 and over 20 in 93 (4000 draws each).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95
RESAMPLES = 2000
"""Bootstrap resamples of each interval."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A number that seeds were pooled into, and how sure it is.

    Attributes:
        value: The estimate.
        low: Lower end of its 95 % interval; None where a single seed allows no interval.
        high: Upper end, likewise.
    """

    value: float
    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        if self.low is None or self.high is None:
            return f"{self.value:.3f} (one seed, no interval)"
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


def interquartile_mean(scores: ArrayLike) -> Estimate:
    """The mean of the middle half of all scores, shape (seeds, scenarios).

    A quarter of the numbers, rounded down, is left out at either end. The interval is a percentile
    bootstrap that is stratified by scenario: seeds are drawn anew within each scenario.

    Raises:
        ValueError: The scores are not of that shape, or not all finite.
    """
    return _estimate(_interquartile_mean, _check("scores", scores))


def mean(scores: ArrayLike) -> Estimate:
    """The mean of scores, shape (seeds, scenarios), with a stratified bootstrap interval as above.

    Raises:
        ValueError: The scores are not of that shape, or not all finite.
    """
    return _estimate(np.mean, _check("scores", scores))


def probability_of_improvement(a: ArrayLike, b: ArrayLike) -> Estimate:
    """How probable it is that a seed of ``a`` scores more than a seed of ``b``.

    For each scenario the share of the pairs in which ``a`` has more, equal scores counting one
    half; then the mean over the scenarios. 0.5 says that neither is better. The interval draws
    the seeds of both anew, within each scenario.

    Args:
        a: Scores of one method, shape (seeds, scenarios).
        b: Scores of another one in the same scenarios, shape (other seeds, scenarios).

    Raises:
        ValueError: The scores are not of those shapes, or not all finite.
    """
    a, b = _check("a", a), _check("b", b)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"a has {a.shape[1]} scenarios and b {b.shape[1]}; give the same ones.")
    return _estimate(_share_of_pairs, a, b)


def mean_curve(curves: ArrayLike) -> tuple[Array, Array | None, Array | None]:
    """The mean of learning curves, with a 95 % interval at each point.

    The interval is a percentile bootstrap over the seeds, each point for itself.

    Args:
        curves: One curve per seed, shape (seeds, points).

    Returns:
        The mean and the ends of its interval, shape (points,); the ends are None for one seed.

    Raises:
        ValueError: The curves are not of that shape, or not all finite.
    """
    curves = _check("curves", curves)
    if len(curves) == 1:
        return curves[0], None, None
    # A single scenario, so that a draw of a seed is of its whole curve.
    low, high = _interval(lambda draw: draw.mean(axis=(0, 1)), curves[:, None])
    return curves.mean(axis=0), low, high


def _check(name: str, scores: ArrayLike) -> Array:
    array = np.asarray(scores, dtype=np.float64)
    if array.ndim != 2 or not array.size:
        raise ValueError(f"{name} has shape {array.shape}; it must have two axes, seeds first.")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite; every seed needs every score.")
    return array


def _estimate(statistic: Callable[..., Any], *scores: Array) -> Estimate:
    value = float(statistic(*scores))
    if min(map(len, scores)) == 1:
        return Estimate(value)
    low, high = _interval(statistic, *scores)
    return Estimate(value, float(low), float(high))


def _interval(statistic: Callable[..., Any], *scores: Array) -> Array:
    rng = np.random.default_rng(0)  # the same scores give the same interval

    def resample(array: Array) -> Array:
        seeds, scenarios = array.shape[:2]
        return array[rng.integers(seeds, size=(seeds, scenarios)), np.arange(scenarios)]

    draws = [statistic(*map(resample, scores)) for _ in range(RESAMPLES)]
    return np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)


def _interquartile_mean(scores: Array) -> float:
    from scipy import stats  # slow to import

    return float(stats.trim_mean(scores, 0.25, axis=None))


def _share_of_pairs(a: Array, b: Array) -> float:
    more, equal = a[:, None] > b[None], a[:, None] == b[None]
    return float((more + 0.5 * equal).mean())
