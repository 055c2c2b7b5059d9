"""Pictures of learning curves with their intervals over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fbrl.analysis.run_groups import LearningCurve
from fbrl.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXIS_NAMES = {
    "match/goal_difference": "goal difference per match,\nlast 100 training matches",
    "match/length": "length of a match (frames)",
    "reward/total": "reward per match",
    "evaluation/goal_difference": "goal difference per match,\nfresh matches",
    "time/frames_per_second": "frames per second",
}
"""What the y axis says; for other metrics, their names."""


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
        MissingExtraError: matplotlib is not installed.
    """
    figure, axes = style.new_figure(7.0, 4.2)
    for index, curve in enumerate(curves):
        colour = style.COLOURS[index % len(style.COLOURS)]
        dashes = style.LINE_STYLES[index // len(style.COLOURS) % len(style.LINE_STYLES)]
        seeds = "1 seed" if curve.seeds == 1 else f"{curve.seeds} seeds"
        axes.plot(
            curve.frames, curve.mean, color=colour, linestyle=dashes, linewidth=1.8,
            marker="o" if len(curve.frames) < 3 else None, label=f"{curve.label} ({seeds})",
        )  # fmt: skip
        if curve.low is not None and curve.high is not None:
            axes.fill_between(
                curve.frames, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0
            )
    if threshold is not None:
        axes.axhline(
            threshold, color="#555555", linestyle=(0, (4, 3)), linewidth=1.2,
            label=f"threshold {threshold:g}",
        )  # fmt: skip
    frames = style.count_frames(axes.xaxis, max(curve.frames[-1] for curve in curves))
    style.set_labels(axes, title, frames, AXIS_NAMES.get(metric, metric))
    axes.margins(x=0.01)
    has_band = any(curve.low is not None for curve in curves)
    style.add_legend(axes, "line: mean of the seeds, band: its 95 % interval" if has_band else None)
    return figure
