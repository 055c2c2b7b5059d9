"""``fbrl-plot``: draws what runs have logged, as figures for papers."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbrl.cli.arguments import DEFAULT_TOLERANCE, finite_number, number_from_zero, positive_integer
from fbrl.cli.errors import Parser, add_command, run_command
from fbrl.cli.outputs import add_figure_option, check_figure_outputs, console, write_figure
from fbrl.policy_names import MODES

if TYPE_CHECKING:
    from fbrl.analysis.results import PooledResult
    from fbrl.analysis.run_groups import RunGroup

PROGRAM = "fbrl-plot"

_DESCRIPTION = """\
Draw figures for papers from what fbrl-train and fbrl-eval have written, as PNG or SVG by the name's
ending; several names give several files. Needs pip install 'fbrl[analysis]'."""

_EPILOG = """\
examples (more of them: fbrl-plot curves --help, fbrl-plot bars --help):
  fbrl-plot curves runs/academy_3_vs_1_with_keeper/* --out curves.png curves.svg
  fbrl-plot bars runs/*/* --out goals.png"""

_CURVES = """\
Draw learning curves. Runs of one scenario whose configurations differ in the seed alone are pooled:
the line is the mean of the seeds, the band its 95 % bootstrap interval. A single seed has no band.

  fbrl-plot curves runs/academy_3_vs_1_with_keeper/* --out curves.png curves.svg

  fbrl-plot curves my-run --metric match/length --smooth 10 --out length.png

  fbrl-plot curves a-0 a-1 b-0 b-1 --label "with densities" "goals alone" --out ablation.svg

  fbrl-plot curves runs/academy_corner/* --threshold 0.3 --out corner.png"""

_BARS = """\
Draw bars for each scenario and reward, as in the thesis's Figures 6.1 to 6.3. The measures:

  goal-difference  on fresh matches, in the scenario trained on: the last evaluation of each run, or
                   the rows of a table of fbrl-eval --csv
  convergence      frames until the goal difference of the last 100 training matches reaches
                   --threshold and keeps it to the end of the run (down to --tolerance below it)
  generalisation   goal difference in scenarios not trained on: from tables of fbrl-eval --csv

  fbrl-plot bars runs/*/* --out goals.png

  fbrl-plot bars runs/*/* --measure convergence --threshold 0.3 --out frames.png

  fbrl-plot bars others.csv --measure generalisation --reference mine.csv --out others.svg

Bars are the plain mean of the seeds, as publications give it for a scenario, and the median for
convergence. (fbrl-eval pools seeds and scenarios together into the interquartile mean.)

Published numbers stand beside ours as hatched bars: those that the thesis gives, its own and those
of the environment's authors (Kurach et al.), with --reference thesis, or a table's:

  scenario,reward,value,measure,model
  academy_corner,checkpoints,PUBLISHED_NUMBER,goal-difference,Somebody et al.

The columns measure and model may be left out. Values are goals per match, or frames for
convergence; the model, or the file's name without its ending, stands in the legend."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if it was interrupted."""
    run_command(_parser().parse_args(arguments), "interrupted; nothing was written")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, epilog=_EPILOG)
    commands = parser.add_subparsers(metavar="{curves,bars}", required=True)
    _add_curves(commands)
    _add_bars(commands)
    return parser


def _add_curves(commands: Any) -> None:
    curves = add_command(commands, "curves", _curves, "draw learning curves", _CURVES)
    add = curves.add_argument
    add("runs", type=Path, nargs="+", metavar="RUN", help="directory of a run")
    add(
        "--metric",
        default="match/goal_difference",
        help="any column of metrics.csv or evaluations.csv",
    )
    add(
        "--smooth",
        type=positive_integer,
        default=1,
        metavar="N",
        help="draw the mean of the last N logged points",
    )
    add("--each", action="store_true", help="a curve for each run, named by its directory")
    add("--label", nargs="+", metavar="TEXT", help="one for each curve, in the order of the runs")
    add("--title", help="above the figure (default: the scenario)")
    _add_threshold(curves, "draw a line there and print when each run has reached and kept it")
    add_figure_option(curves)


def _add_bars(commands: Any) -> None:
    from fbrl.analysis.results import MEASURES

    bars = add_command(commands, "bars", _bars, "draw bars per scenario and reward", _BARS)
    add = bars.add_argument
    add(
        "sources",
        type=Path,
        nargs="+",
        metavar="RUN_OR_TABLE",
        help="directory of a run, or table of fbrl-eval --csv",
    )
    add("--measure", choices=MEASURES, default=MEASURES[0], help="default: %(default)s")
    add("--mode", choices=MODES, default=MODES[0], help="rows that are taken from tables")
    add("--reference", type=Path, metavar="thesis|FILE", help="published numbers")
    add("--title", default="", help="above the figure")
    _add_threshold(bars, "goal difference that counts as converged; convergence needs it")
    add_figure_option(bars)


def _add_threshold(parser: Parser, meaning: str) -> None:
    """Adds ``--threshold`` and ``--tolerance``."""
    parser.add_argument("--threshold", type=finite_number, metavar="VALUE", help=meaning)
    parser.add_argument(
        "--tolerance",
        type=number_from_zero,
        metavar="VALUE",
        help="how far below the threshold still counts as kept, as the mean of 100 matches is "
        f"noisy (default: {DEFAULT_TOLERANCE}, as in fbrl-eval)",
    )


def _curves(options: argparse.Namespace) -> None:
    from fbrl.analysis.run_groups import group_runs, learning_curve, single_runs
    from fbrl.analysis.run_log import read_run_log
    from fbrl.figures.curves import learning_curves_figure

    _check_tolerance(options)
    check_figure_outputs(options)
    runs = [read_run_log(path) for path in options.runs]
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
            f"{group.label}: {_count(curve.seeds, 'seed')}, {curve.mean[-1]:.3f} at "
            f"{curve.frames[-1]:,.0f} frames"
        )
        _tell_convergence(group, options)
        _tell_cut(group, curve.frames[-1], options.metric)


def _relabel(groups: list[RunGroup], labels: Sequence[str] | None) -> list[RunGroup]:
    if labels is None:
        return groups
    if len(labels) != len(groups):
        own = "; ".join(group.label for group in groups)
        raise ValueError(f"There are {len(labels)} labels for {len(groups)} curves ({own}).")
    pairs = zip(groups, labels, strict=True)
    return [dataclasses.replace(group, label=label) for group, label in pairs]


def _tell_convergence(group: RunGroup, options: argparse.Namespace) -> None:
    from fbrl.analysis.run_log import frames_until

    if options.threshold is None:
        return
    for run in group.runs:
        reached = frames_until(*run.curve(options.metric), options.threshold, options.tolerance)
        told = "not reached and kept" if reached is None else f"kept from {reached:,} frames on"
        console().print(f"  {run.run_dir}: {options.threshold:g} {told}")


def _tell_cut(group: RunGroup, end: float, metric: str) -> None:
    if max(run.curve(metric)[0][-1] for run in group.runs) > end:
        shortest = min(group.runs, key=lambda run: run.curve(metric)[0][-1])
        console().print(
            f"  drawn up to {end:,.0f} frames, where {shortest.run_dir} ends and others don't"
        )


def _bars(options: argparse.Namespace) -> None:
    from fbrl.analysis.results import (
        convergence,
        final_goal_differences,
        pool_results,
        published_beside,
        read_published,
    )
    from fbrl.analysis.results import read_evaluation_table as read_table
    from fbrl.analysis.run_groups import group_runs
    from fbrl.analysis.run_log import read_run_log
    from fbrl.figures.bars import bars_figure

    _check_tolerance(options)
    tables = [path for path in options.sources if path.is_file()]
    runs = [path for path in options.sources if path not in tables]
    _check_sources(options.measure, options.threshold, runs, tables)
    check_figure_outputs(options)
    groups = group_runs([read_run_log(path) for path in runs], always=("reward",))
    if options.measure == "convergence":
        results = convergence(groups, options.threshold, options.tolerance)
    else:
        results = final_goal_differences(groups)
        for path in tables:
            results += read_table(path, options.measure, options.mode)
    bars = pool_results(results, options.measure)
    left_out = 0
    if options.reference is not None:
        published = read_published(options.reference, options.measure)
        bars += published_beside(bars, published, options.reference.stem)
        left_out = len({row.scenario for row in published} - {bar.scenario for bar in bars})
    write_figure(options, bars_figure(bars, options.measure, options.title))
    if left_out:
        scenarios = _count(left_out, "scenario")
        console().print(f"{options.reference} has {scenarios} that ours don't play.")
    _print_bars(bars, options.measure)


def _check_sources(
    measure: str, threshold: float | None, runs: list[Path], tables: list[Path]
) -> None:
    if measure == "convergence" and tables:
        raise ValueError(
            f"{tables[0]} is a file, but convergence is read from the log of a training: give the "
            "directories of runs."
        )
    if measure == "convergence" and threshold is None:
        raise ValueError("Convergence is the way to a goal difference: give it as --threshold.")
    if measure != "convergence" and threshold is not None:
        raise ValueError(f"--threshold is for convergence, and the measure is {measure}.")
    if measure == "generalisation" and runs:
        raise ValueError(
            f"{runs[0]} is no file, but generalisation is read from tables: let agents play other "
            "scenarios with fbrl-eval --scenario --csv."
        )


def _print_bars(bars: Sequence[PooledResult], measure: str) -> None:
    width = max(len(bar.scenario) for bar in bars)
    agents = max(len(bar.agent) for bar in bars)
    scenarios = list(dict.fromkeys(bar.scenario for bar in bars))
    for bar in sorted(bars, key=lambda bar: scenarios.index(bar.scenario)):
        number = f"{bar.value:,.0f}" if bar.value > 1000 else f"{bar.value:.3f}"
        if not math.isfinite(bar.value):
            number = "not reached"
        interval = "" if bar.low is None else f" [{bar.low:.3f}, {bar.high:.3f}]"
        seeds = _seeds(bar, measure)
        console().print(f"{bar.scenario:{width}}  {bar.agent:{agents}}  {number}{interval}{seeds}")


def _seeds(bar: PooledResult, measure: str) -> str:
    if not bar.values or not bar.reward:
        return ""
    seeds = _count(len(bar.values), "seed")
    if len(bar.values) == 1:
        return f" ({seeds})"
    if measure == "convergence":
        return f" (median of {seeds}, {bar.reached} got there)"
    return f" (mean of {seeds})"


def _check_tolerance(options: argparse.Namespace) -> None:
    """Fills in ``--tolerance``, and refuses it without ``--threshold``."""
    if options.threshold is None and options.tolerance is not None:
        raise ValueError("--tolerance is how far below --threshold counts as kept: give both.")
    if options.tolerance is None:
        options.tolerance = DEFAULT_TOLERANCE


def _count(number: int, thing: str) -> str:
    """Such as "1 seed" or "2 seeds"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
