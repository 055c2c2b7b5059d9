"""``fbrl-plot``: draws what runs have logged, as figures for papers."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbrl.cli.commands import add_command, check_outputs, console
from fbrl.cli.errors import Parser, fail

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fbrl.figures.bars import Bar
    from fbrl.run_groups import RunGroup
    from fbrl.run_log import RunLog

PROGRAM = "fbrl-plot"
INTERRUPTED = 130

_DESCRIPTION = """\
Draw figures for papers from what fbrl-train and fbrl-eval have written, as PNG or SVG by the name's
ending; several names give several files. Needs pip install 'fbrl[analysis]'."""

_CURVES = """\
Draw learning curves. Runs of one scenario whose configurations differ in the seed alone are pooled:
the line is the mean of the seeds, the band its 95 % bootstrap interval. A single seed has no band.

  fbrl-plot curves runs/academy_3_vs_1_with_keeper/* --out curves.png curves.svg

  fbrl-plot curves my-run --metric match/length --smooth 10 --out length.png

  fbrl-plot curves a-0 a-1 b-0 b-1 --label "with densities" "goals alone" --out ablation.svg

  fbrl-plot curves runs/academy_corner/* --threshold 0.3 --tolerance 0.1 --out corner.png"""

_BARS = """\
Draw bars for each scenario and reward, as in the thesis's Figures 6.1 to 6.3. The measures:

  goal-difference  on fresh matches, in the scenario trained on: the last evaluation of each run, or
                   the rows of a table of fbrl-eval --csv
  convergence      frames until the goal difference of the last 100 training matches reaches
                   --threshold and keeps it to the end of the run (down to --tolerance below it)
  generalisation   goal difference in scenarios not trained on: from tables of fbrl-eval --csv

  fbrl-plot bars runs/*/* --out goals.png

  fbrl-plot bars runs/*/* --measure convergence --threshold 0.3 --tolerance 0.1 --out frames.png

  fbrl-plot bars others.csv --measure generalisation --reference thesis.csv --out others.svg

Published numbers stand beside ours as hatched bars where a table gives them:

  scenario,reward,value,measure
  academy_corner,checkpoints,PUBLISHED_NUMBER,goal-difference

The column measure may be left out. Values are goals per match, or frames for convergence; the
file's name without its ending stands in the legend."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if it was interrupted."""
    options = _parser().parse_args(sys.argv[1:] if arguments is None else arguments)
    try:
        options.command(options)
    except (ValueError, OSError, ImportError) as error:
        fail(options.program, error)
    except KeyboardInterrupt:
        print(f"{options.program}: interrupted; nothing was written", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(0)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, allow_abbrev=False)
    commands = parser.add_subparsers(metavar="{curves,bars}", required=True)
    _add_curves(commands)
    _add_bars(commands)
    return parser


def _add_curves(commands: Any) -> None:
    curves = add_command(commands, "curves", _curves, "draw learning curves", _CURVES)
    curves.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="directory of a run")
    curves.add_argument(
        "--metric",
        default="match/goal_difference",
        help="any column of metrics.csv or evaluations.csv (default: %(default)s)",
    )
    curves.add_argument(
        "--smooth",
        type=_positive,
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
    _add_threshold(curves, "draw a line there and print when each run has reached and kept it")
    _add_out(curves)


def _add_bars(commands: Any) -> None:
    from fbrl.results import MEASURES

    bars = add_command(commands, "bars", _bars, "draw bars per scenario and reward", _BARS)
    bars.add_argument(
        "sources",
        type=Path,
        nargs="+",
        metavar="RUN_OR_TABLE",
        help="directory of a run, or table of fbrl-eval --csv",
    )
    bars.add_argument(
        "--measure", choices=MEASURES, default=MEASURES[0], help="default: %(default)s"
    )
    bars.add_argument(
        "--mode",
        choices=("sample", "greedy"),
        default="sample",
        help="rows that are taken from tables (default: %(default)s)",
    )
    bars.add_argument("--reference", type=Path, metavar="FILE", help="table of published numbers")
    bars.add_argument("--title", default="", help="above the figure")
    _add_threshold(bars, "goal difference that counts as converged; convergence needs it")
    _add_out(bars)


def _add_threshold(parser: Parser, meaning: str) -> None:
    parser.add_argument("--threshold", type=float, metavar="VALUE", help=meaning)
    parser.add_argument(
        "--tolerance",
        type=_not_negative,
        metavar="VALUE",
        help="how far below the threshold still counts as kept; a mean over 100 matches is noisy "
        "(default: 0)",
    )


def _add_out(parser: Parser) -> None:
    parser.add_argument(
        "--out", type=Path, nargs="+", required=True, help="figures to write: .png, .svg or both"
    )


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def _not_negative(text: str) -> float:
    number = float(text)
    if not number >= 0:
        raise argparse.ArgumentTypeError(f"{text} is not at least 0")
    return number


def _curves(options: argparse.Namespace) -> None:
    from fbrl.figures.learning_curves import learning_curve, learning_curves_figure
    from fbrl.run_groups import group_runs, single_runs

    _check_tolerance(options)
    _check_out(options)
    runs = _read_runs(options.runs)
    scenarios = list(dict.fromkeys(run.config.scenario for run in runs))
    if len(scenarios) > 1:
        raise ValueError(
            f"The runs play {len(scenarios)} scenarios, {', '.join(scenarios)}, whose curves can't "
            "be compared. Draw a figure for each."
        )
    groups = _relabel(single_runs(runs) if options.each else group_runs(runs), options.label)
    curves = [learning_curve(group, options.metric, options.smooth) for group in groups]
    for group, curve in zip(groups, curves, strict=True):
        console().print(
            f"{group.label}: {_count(curve.seeds, 'seed')}, {curve.mean[-1]:.3f} at "
            f"{curve.frames[-1]:,.0f} frames"
        )
        _tell_convergence(group, options)
        _tell_cut(group, curve.frames[-1], options.metric)
    title = options.title if options.title is not None else scenarios[0]
    _save(options, learning_curves_figure(curves, options.metric, title, options.threshold))


def _bars(options: argparse.Namespace) -> None:
    from fbrl.figures.bars import bars_figure, pool_results, published_bars
    from fbrl.results import convergence, final_goal_differences, read_published
    from fbrl.results import read_evaluation_table as read_table
    from fbrl.run_groups import group_runs

    _check_tolerance(options)
    _check_sources(options)
    _check_out(options)
    tables = [path for path in options.sources if path.is_file()]
    groups = group_runs(
        _read_runs([path for path in options.sources if path not in tables]), always=("reward",)
    )
    if options.measure == "convergence":
        results = convergence(groups, options.threshold, options.tolerance or 0.0)
    else:
        results = final_goal_differences(groups)
        for path in tables:
            results += read_table(path, options.measure, options.mode)
    bars = pool_results(results, options.measure)
    if options.reference is not None:
        published = read_published(options.reference, options.measure)
        bars += published_bars(published, options.reference.stem, bars)
        left_out = len({row.scenario for row in published} - {bar.scenario for bar in bars})
        if left_out:
            scenarios = _count(left_out, "scenario")
            console().print(f"{options.reference} has {scenarios} that ours don't play.")
    _print_bars(bars)
    _save(options, bars_figure(bars, options.measure, options.title))


def _check_tolerance(options: argparse.Namespace) -> None:
    if options.threshold is None and options.tolerance is not None:
        raise ValueError("--tolerance is how far below --threshold counts as kept: give both.")


def _check_sources(options: argparse.Namespace) -> None:
    is_table = [path.is_file() for path in options.sources]
    if options.measure == "convergence" and any(is_table):
        raise ValueError(
            f"{options.sources[is_table.index(True)]} is a file, but convergence is read from the "
            "log of a training: give the directories of runs."
        )
    if options.measure == "convergence" and options.threshold is None:
        raise ValueError("Convergence is the way to a goal difference: give it as --threshold.")
    if options.measure != "convergence" and options.threshold is not None:
        raise ValueError(f"--threshold is for convergence, and the measure is {options.measure}.")
    if options.measure == "generalisation" and not all(is_table):
        raise ValueError(
            f"{options.sources[is_table.index(False)]} is no file, but generalisation is read from "
            "tables: let agents play other scenarios with fbrl-eval --scenario --csv."
        )


def _read_runs(paths: Sequence[Path]) -> list[RunLog]:
    from fbrl.run_log import read_run_log

    return [read_run_log(path) for path in paths]


def _relabel(groups: Sequence[RunGroup], labels: Sequence[str] | None) -> list[RunGroup]:
    import dataclasses

    if labels is None:
        return list(groups)
    if len(labels) != len(groups):
        own = "; ".join(group.label for group in groups)
        raise ValueError(f"There are {len(labels)} labels for {len(groups)} curves ({own}).")
    return [
        dataclasses.replace(group, label=label) for group, label in zip(groups, labels, strict=True)
    ]


def _tell_convergence(group: RunGroup, options: argparse.Namespace) -> None:
    from fbrl.run_log import frames_until

    if options.threshold is None:
        return
    for run in group.runs:
        reached = frames_until(
            *run.curve(options.metric), options.threshold, options.tolerance or 0.0
        )
        told = "not reached and kept" if reached is None else f"kept from {reached:,} frames on"
        console().print(f"  {run.run_dir}: {options.threshold:g} {told}")


def _tell_cut(group: RunGroup, end: float, metric: str) -> None:
    cut = max(run.curve(metric)[0][-1] for run in group.runs) > end
    if cut:
        shortest = min(group.runs, key=lambda run: run.curve(metric)[0][-1])
        console().print(
            f"  drawn up to {end:,.0f} frames, where {shortest.run_dir} ends and others don't"
        )


def _print_bars(bars: Sequence[Bar]) -> None:
    width = max(len(bar.scenario) for bar in bars)
    agents = max(len(bar.agent) for bar in bars)
    scenarios = list(dict.fromkeys(bar.scenario for bar in bars))
    for bar in sorted(bars, key=lambda bar: scenarios.index(bar.scenario)):
        number = _number(bar.height)
        interval = "" if bar.low is None else f" [{bar.low:.3f}, {bar.high:.3f}]"
        seeds = f" ({bar.reached} of {_count(len(bar.values), 'seed')})" if bar.values else ""
        console().print(f"{bar.scenario:{width}}  {bar.agent:{agents}}  {number}{interval}{seeds}")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _number(height: float) -> str:
    if not math.isfinite(height):
        return "not reached"
    return f"{height:,.0f}" if height > 1000 else f"{height:.3f}"


def _check_out(options: argparse.Namespace) -> None:
    from fbrl.figures.files import check_figure_path

    check_outputs(*map(check_figure_path, options.out))


def _save(options: argparse.Namespace, figure: Figure) -> None:
    from fbrl.figures.files import save_figure

    save_figure(figure, *options.out)
    for path in options.out:
        console().print(f"Written to {path}")
