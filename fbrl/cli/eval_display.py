"""What ``fbrl-eval`` shows: the progress while matches are played, and the tables at the end."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from fbrl.cli.progress import ProgressDisplay

SECONDS_BETWEEN_LINES = 30.0

_ACTIONS = {"sample": "sampled", "greedy": "greedy", None: ""}

Row = Mapping[str, Any]


class EvaluationProgress(ProgressDisplay):
    """Shows how many matches of each evaluation are over.

    Args:
        episodes: Matches of each evaluation.
    """

    def __init__(self, episodes: int) -> None:
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            seconds_between_lines=SECONDS_BETWEEN_LINES,
        )
        self._episodes = episodes

    def of(self, description: str) -> Callable[[int], None]:
        """Begins an evaluation; the result is to be called after each step of all its matches.

        Its argument is the number of matches finished so far.
        """
        task = self.bars.add_task(description, total=self._episodes)
        steps = itertools.count(1)

        def show(done: int) -> None:
            # Matches of 3000 steps end minutes apart, and nearly all at once.
            status = f"{description}, {next(steps):,} steps each"
            self.bars.update(task, completed=min(done, self._episodes), description=status)
            self.line(f"{status}: {done}/{self._episodes} matches")

        return show


def print_report(report: Mapping[str, Sequence[Row]]) -> None:
    """Prints the tables of results, of seeds pooled, and of trainings, as far as there are any."""
    # Wide enough for whole names, also where the output goes to a file.
    console = Console(highlight=False, markup=False)
    console.width = max(console.width, 160)
    results = report["results"]
    for line in dict.fromkeys(map(_about, results)):
        if line:
            console.print(line)
    console.print(_results_table(results))
    console.print(_play_table(results))
    if report["seeds"]:
        console.print(_seeds_table(report["seeds"]))
    if report["improvements"]:
        console.print(_improvements_table(report["improvements"]))
    if report["training"]:
        console.print(_training_table(report["training"]))


def _about(row: Row) -> str:
    """What a trained agent is; nothing for other policies, whose name says it."""
    if row["trained_on"] is None:
        return ""
    return (
        f"{row['policy']}: {row['reward']} reward, preset {row['preset']}, seed {row['seed']}, "
        f"trained on {row['trained_on']} for {row['frames']:,} frames"
    )


def _table(title: str, left: Sequence[str], right: Sequence[str]) -> Table:
    table = Table(*left, box=SIMPLE, title=title, title_justify="left", title_style="")
    for column in right:
        table.add_column(column, justify="right")
    return table


def _who(row: Row) -> tuple[str, str, str]:
    return row["policy"], row["scenario"], _ACTIONS[row["mode"]]


def _results_table(results: Sequence[Row]) -> Table:
    table = _table(
        "Goals per match (mean, 95 % interval)",
        ("policy", "scenario", "actions"),
        ("matches", "goal difference", "won/drawn/lost", "for", "against"),
    )
    for row in results:
        table.add_row(
            *_who(row),
            str(row["matches"]),
            _interval(row, "goal_difference", "+.3f"),
            f"{row['won']}/{row['drawn']}/{row['lost']}",
            f"{row['goals_for']:.3f}",
            f"{row['goals_against']:.3f}",
        )
    return table


def _play_table(results: Sequence[Row]) -> Table:
    parts = list(
        dict.fromkeys(name for row in results for name in row if name.startswith("episode_reward_"))
    )
    table = _table(
        "Play per match (means)",
        ("policy", "scenario", "actions"),
        ("steps", "possession", "passes", "shots", *map(_part_name, parts)),
    )
    for row in results:
        share = row["possession_share"]
        table.add_row(
            *_who(row),
            f"{row['length']:.0f}",
            "" if share is None else f"{share:.0%}",
            f"{row['passes']:.2f}",
            f"{row['shots']:.2f}",
            *("" if row.get(name) is None else f"{row[name]:+.4f}" for name in parts),
        )
    return table


def _part_name(key: str) -> str:
    return key.removeprefix("episode_reward_").replace("_", " ")


def _seeds_table(seeds: Sequence[Row]) -> Table:
    table = _table(
        "Goal difference over seeds (interquartile mean, 95 % interval)",
        ("configuration", "actions"),
        ("seeds", "scenarios", "goal difference"),
    )
    for row in seeds:
        table.add_row(
            row["configuration"],
            _ACTIONS[row["mode"]],
            str(row["seeds"]),
            str(len(row["scenarios"])),
            _interval(row, "interquartile_mean", "+.3f"),
        )
    return table


def _improvements_table(improvements: Sequence[Row]) -> Table:
    table = _table(
        "Probability that a seed of the first scores more than one of the second (95 % interval)",
        ("first", "second", "actions"),
        ("probability",),
    )
    for row in improvements:
        table.add_row(
            row["configuration"],
            row["over"],
            _ACTIONS[row["mode"]],
            _interval(row, "probability", ".2f"),
        )
    return table


def _training_table(training: Sequence[Row]) -> Table:
    threshold, tolerance = training[0]["threshold"], training[0]["tolerance"]
    table = _table(
        "Training (from its log)",
        ("run",),
        (
            "frames",
            f"frames until {threshold:g} was reached and {threshold - tolerance:g} kept",
            "goal difference of the last 100 training matches",
        ),
    )
    for row in training:
        until, goals = row["frames_until_threshold"], row["paper_goal_difference"]
        table.add_row(
            row["policy"],
            f"{row['frames']:,}",
            "never" if until is None else f"{until:,}",
            "" if goals is None else f"{goals:+.3f}",
        )
    return table


def _interval(row: Row, name: str, form: str) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if low is None or high is None:
        return f"{row[name]:{form}} (one seed)"
    return f"{row[name]:{form}} [{low:{form}}, {high:{form}}]"
