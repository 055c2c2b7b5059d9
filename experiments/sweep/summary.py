"""What a sweep has come to: a table of its trainings, and the command that draws them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from grid import Point
from rich.console import Console
from rich.table import Table

from fbrl.analysis.run_log import RunLogError, read_run_log


def print_summary(points: Sequence[Point], failures: Mapping[Point, str]) -> None:
    """Prints a line for each training, how to draw all of them, and what went wrong.

    Args:
        points: The sweep's.
        failures: How the trainings ended that did not go well, in words.
    """
    table = Table("run", "state", "frames", "goal difference", box=None, pad_edge=False)
    for point in points:
        state = "failed" if point in failures else "finished"
        table.add_row(
            point.run_dir.name, state, f"{point.frames_done():,}", latest_goal_difference(point)
        )
    # A terminal breaks a long line, and a file has no width: nothing is to be cut off.
    Console(width=1000, highlight=False, markup=False).print(table)
    print("Draw them with:", *plot_commands(points), sep="\n  ")
    for point, outcome in failures.items():
        print(f"{point.run_dir}: {outcome}")
    print(f"{len(points) - len(failures)} of {len(points)} trainings are finished.")
    if failures:
        print("The same command tries those that failed again.")


def latest_goal_difference(point: Point) -> str:
    """The goal difference of a run: of its last evaluation, else of its last training matches."""
    for name, where in (
        ("evaluation/goal_difference", "evaluation"),
        ("match/goal_difference", "training matches"),
    ):
        try:
            _, values = read_run_log(point.run_dir).curve(name)
        except (RunLogError, ValueError):
            continue
        if len(values):
            return f"{values[-1]:+.2f} ({where})"
    return ""


def plot_commands(points: Sequence[Point]) -> list[str]:
    """Commands that draw the sweep: curves of each scenario and, where it was evaluated, bars."""
    runs = shlex.quote(str(points[0].run_dir.parent))
    patterns = {point.config.scenario: _pattern(point) for point in points}
    commands = [
        f"fbrl-plot curves {runs}/{pattern}/ --out {scenario}.png"
        for scenario, pattern in patterns.items()
    ]
    if all(point.config.eval_episodes for point in points):
        commands.append(f"fbrl-plot bars {runs}/*/ --out goals.png")
    return commands


def _pattern(point: Point) -> str:
    """What the shell completes to the runs of a point's scenario."""
    chosen = f"scenario={point.config.scenario}"
    before, found, after = point.run_dir.name.partition(chosen)
    return f"{'*' if before else ''}{chosen}{',*' if after else ''}" if found else "*"
