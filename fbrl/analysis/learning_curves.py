"""Learning curves of runs, their seeds pooled."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fbrl.analysis.run_groups import RunGroup
from fbrl.analysis.seed_statistics import mean_curve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LearningCurve:
    """A metric over the frames of a training, the mean of the seeds.

    Attributes:
        label: What was trained.
        seeds: How many there are.
        frames: Shape (points,): those at which every seed has a value.
        mean: Over the seeds, shape (points,).
        low: Lower end of its 95 % interval, shape (points,); None for a single seed.
        high: Upper end, likewise.
    """

    label: str
    seeds: int
    frames: Array
    mean: Array
    low: Array | None
    high: Array | None


def learning_curve(group: RunGroup, metric: str, smooth: int = 1) -> LearningCurve:
    """Pools the seeds of a configuration.

    Args:
        group: The runs. Beyond the end of the shortest one nothing is pooled.
        metric: Anything that they have logged.
        smooth: Each point becomes the mean of this many points of the same run up to it, fewer at
            the start.

    Raises:
        UnknownNameError: A run has not logged the metric.
        ValueError: There are no frames at which every run has a value.
    """
    curves = [run.curve(metric) for run in group.runs]
    frames = functools.reduce(np.intersect1d, [frames for frames, _ in curves])
    if not len(frames):
        raise ValueError(
            f"There are no frames at which {' and '.join(str(run.run_dir) for run in group.runs)} "
            f"have a value of {metric}, so there is nothing to draw."
        )
    values = [running_mean(values, smooth)[np.searchsorted(at, frames)] for at, values in curves]
    return LearningCurve(group.label, len(values), frames, *mean_curve(values))


def running_mean(values: Array, count: int) -> Array:
    """The mean of each value and those before it, ``count`` in all or as many as there are."""
    ends = range(1, len(values) + 1)
    return np.array([values[max(end - count, 0) : end].mean() for end in ends])
