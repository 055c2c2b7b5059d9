"""Learning curves with intervals over seeds."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fbrl.analysis.run_groups import RunGroup
from fbrl.analysis.seed_statistics import mean_curve
from fbrl.figures.style import (
    COLOURS,
    LINE_STYLES,
    add_legend,
    count_frames,
    new_figure,
    set_labels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

AXIS_NAMES = {
    "match/goal_difference": "goal difference per match,\nlast 100 training matches",
    "match/length": "length of a match (steps)",
    "reward/total": "reward per match",
    "evaluation/goal_difference": "goal difference per match,\nfresh matches",
    "time/frames_per_second": "frames per second",
}
"""What the y axis says; for other metrics, their names."""


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


def learning_curves_figure(
    curves: Sequence[LearningCurve], metric: str, title: str, threshold: float | None = None
) -> Figure:
    """Learning curves in one pair of axes, with their intervals as bands.

    Args:
        curves: At least one.
        metric: What they show.
        title: What is said of them, such as the scenario.
        threshold: Where to draw a horizontal line.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure, axes = new_figure(7.0, 4.2)
    for index, curve in enumerate(curves):
        colour = COLOURS[index % len(COLOURS)]
        style = LINE_STYLES[index // len(COLOURS) % len(LINE_STYLES)]
        seeds = "1 seed" if curve.seeds == 1 else f"{curve.seeds} seeds"
        axes.plot(
            curve.frames,
            curve.mean,
            color=colour,
            linestyle=style,
            linewidth=1.8,
            marker="o" if len(curve.frames) < 3 else None,
            label=f"{curve.label} ({seeds})",
        )
        if curve.low is not None and curve.high is not None:
            axes.fill_between(
                curve.frames, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0
            )
    if threshold is not None:
        axes.axhline(
            threshold, color="#555555", linestyle=(0, (4, 3)), linewidth=1.2,
            label=f"threshold {threshold:g}",
        )  # fmt: skip
    frames = count_frames(axes.xaxis, max(curve.frames[-1] for curve in curves))
    set_labels(axes, title, frames, AXIS_NAMES.get(metric, metric))
    axes.margins(x=0.01)
    has_band = any(curve.low is not None for curve in curves)
    add_legend(axes, "line: mean of the seeds, band: its 95 % interval" if has_band else None)
    return figure
