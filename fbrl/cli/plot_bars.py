"""``fbrl-plot bars``: results per scenario and reward."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbrl.cli.outputs import (
    add_figure_option,
    check_figure_outputs,
    console,
    write_figure,
)
from fbrl.cli.plot_common import add_threshold, check_tolerance, count, read_runs
from fbrl.cli.subcommands import add_command
from fbrl.policy_names import MODES

if TYPE_CHECKING:
    from fbrl.analysis.results import PooledResult

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


def add_bars(commands: Any) -> None:
    """Adds the subcommand."""
    from fbrl.analysis.results import MEASURES

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
        choices=MODES,
        default=MODES[0],
        help="rows that are taken from tables (default: %(default)s)",
    )
    bars.add_argument("--reference", type=Path, metavar="thesis|FILE", help="published numbers")
    bars.add_argument("--title", default="", help="above the figure")
    add_threshold(bars, "goal difference that counts as converged; convergence needs it")
    add_figure_option(bars)


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
    from fbrl.figures.bars import bars_figure

    check_tolerance(options)
    _check_sources(options)
    check_figure_outputs(options)
    tables = [path for path in options.sources if path.is_file()]
    groups = group_runs(
        read_runs([path for path in options.sources if path not in tables]), always=("reward",)
    )
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
        scenarios = count(left_out, "scenario")
        console().print(f"{options.reference} has {scenarios} that ours don't play.")
    _print_bars(bars, options.measure)


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


def _print_bars(bars: Sequence[PooledResult], measure: str) -> None:
    width = max(len(bar.scenario) for bar in bars)
    agents = max(len(bar.agent) for bar in bars)
    scenarios = list(dict.fromkeys(bar.scenario for bar in bars))
    for bar in sorted(bars, key=lambda bar: scenarios.index(bar.scenario)):
        number = _number(bar.value)
        interval = "" if bar.low is None else f" [{bar.low:.3f}, {bar.high:.3f}]"
        seeds = _seeds(bar, measure)
        console().print(f"{bar.scenario:{width}}  {bar.agent:{agents}}  {number}{interval}{seeds}")


def _seeds(bar: PooledResult, measure: str) -> str:
    if not bar.values or not bar.reward:
        return ""
    seeds = count(len(bar.values), "seed")
    if len(bar.values) == 1:
        return f" ({seeds})"
    if measure == "convergence":
        return f" (median of {seeds}, {bar.reached} got there)"
    return f" (mean of {seeds})"


def _number(height: float) -> str:
    if not math.isfinite(height):
        return "not reached"
    return f"{height:,.0f}" if height > 1000 else f"{height:.3f}"
