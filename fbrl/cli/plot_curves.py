"""``fbrl-plot curves``: learning curves with intervals over seeds."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbrl.cli.arguments import positive_integer
from fbrl.cli.outputs import (
    add_figure_option,
    check_figure_outputs,
    console,
    write_figure,
)
from fbrl.cli.plot_common import add_threshold, check_tolerance, count, read_runs
from fbrl.cli.subcommands import add_command

if TYPE_CHECKING:
    from fbrl.analysis.run_groups import RunGroup

_CURVES = """\
Draw learning curves. Runs of one scenario whose configurations differ in the seed alone are pooled:
the line is the mean of the seeds, the band its 95 % bootstrap interval. A single seed has no band.

  fbrl-plot curves runs/academy_3_vs_1_with_keeper/* --out curves.png curves.svg

  fbrl-plot curves my-run --metric match/length --smooth 10 --out length.png

  fbrl-plot curves a-0 a-1 b-0 b-1 --label "with densities" "goals alone" --out ablation.svg

  fbrl-plot curves runs/academy_corner/* --threshold 0.3 --out corner.png"""


def add_curves(commands: Any) -> None:
    """Adds the subcommand."""
    curves = add_command(commands, "curves", _curves, "draw learning curves", _CURVES)
    curves.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="directory of a run")
    curves.add_argument(
        "--metric",
        default="match/goal_difference",
        help="any column of metrics.csv or evaluations.csv (default: %(default)s)",
    )
    curves.add_argument(
        "--smooth",
        type=positive_integer,
        default=1,
        metavar="N",
        help="draw the mean of the last N logged points (default: %(default)s)",
    )
    curves.add_argument(
        "--each", action="store_true", help="a curve for each run, named by its directory"
    )
    curves.add_argument(
        "--label", nargs="+", metavar="TEXT", help="one for each curve, in the order of the runs"
    )
    curves.add_argument("--title", help="above the figure (default: the scenario)")
    add_threshold(curves, "draw a line there and print when each run has reached and kept it")
    add_figure_option(curves)


def _curves(options: argparse.Namespace) -> None:
    from fbrl.analysis.run_groups import group_runs, learning_curve, single_runs
    from fbrl.figures.curves import learning_curves_figure

    check_tolerance(options)
    check_figure_outputs(options)
    runs = read_runs(options.runs)
    scenarios = list(dict.fromkeys(run.config.scenario for run in runs))
    if len(scenarios) > 1:
        raise ValueError(
            f"The runs play {len(scenarios)} scenarios, {', '.join(scenarios)}, whose curves can't "
            "be compared. Draw a figure for each."
        )
    groups = _relabel(single_runs(runs) if options.each else group_runs(runs), options.label)
    curves = [learning_curve(group, options.metric, options.smooth) for group in groups]
    title = options.title if options.title is not None else scenarios[0]
    write_figure(options, learning_curves_figure(curves, options.metric, title, options.threshold))
    for group, curve in zip(groups, curves, strict=True):
        console().print(
            f"{group.label}: {count(curve.seeds, 'seed')}, {curve.mean[-1]:.3f} at "
            f"{curve.frames[-1]:,.0f} frames"
        )
        _tell_convergence(group, options)
        _tell_cut(group, curve.frames[-1], options.metric)


def _relabel(groups: Sequence[RunGroup], labels: Sequence[str] | None) -> list[RunGroup]:
    if labels is None:
        return list(groups)
    if len(labels) != len(groups):
        own = "; ".join(group.label for group in groups)
        raise ValueError(f"There are {len(labels)} labels for {len(groups)} curves ({own}).")
    return [
        dataclasses.replace(group, label=label) for group, label in zip(groups, labels, strict=True)
    ]


def _tell_convergence(group: RunGroup, options: argparse.Namespace) -> None:
    from fbrl.analysis.run_log import frames_until

    if options.threshold is None:
        return
    for run in group.runs:
        reached = frames_until(*run.curve(options.metric), options.threshold, options.tolerance)
        told = "not reached and kept" if reached is None else f"kept from {reached:,} frames on"
        console().print(f"  {run.run_dir}: {options.threshold:g} {told}")


def _tell_cut(group: RunGroup, end: float, metric: str) -> None:
    cut = max(run.curve(metric)[0][-1] for run in group.runs) > end
    if cut:
        shortest = min(group.runs, key=lambda run: run.curve(metric)[0][-1])
        console().print(
            f"  drawn up to {end:,.0f} frames, where {shortest.run_dir} ends and others don't"
        )
