"""The tables that ``fbrl-eval`` prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

Row = Mapping[str, Any]
Cell = Callable[[Row], str]

_ALIGNED_LEFT = ("policy", "scenario", "actions", "configuration", "first", "second", "run")
_REWARD_PART = "episode_reward_"


def print_report(report: Mapping[str, Sequence[Row]]) -> None:
    """Prints the tables of results, of seeds pooled, and of trainings, as far as there are any."""
    # Wide enough for whole names, also where the output goes to a file.
    console = Console(highlight=False, markup=False)
    console.width = max(console.width, 160)
    for line in dict.fromkeys(map(_about, report["results"])):
        if line:
            console.print(line)
    for title, rows, columns in _tables(report):
        table = Table(box=SIMPLE, title=title, title_justify="left", title_style="")
        for name in columns:
            table.add_column(name, justify="left" if name in _ALIGNED_LEFT else "right")
        for row in rows:
            table.add_row(*(cell(row) for cell in columns.values()))
        if rows:
            console.print(table)


def _about(row: Row) -> str:
    """What a trained agent is; nothing for other policies, whose name says it."""
    if row["trained_on"] is None:
        return ""
    return (
        f"{row['policy']}: {row['reward']} reward, preset {row['preset']}, seed {row['seed']}, "
        f"trained on {row['trained_on']} for {row['frames']:,} frames"
    )


def _tables(
    report: Mapping[str, Sequence[Row]],
) -> list[tuple[str, Sequence[Row], dict[str, Cell]]]:
    """For each table its title, its rows, and what it writes of a row in each column."""
    results, training = report["results"], report["training"]
    who = {"policy": _text("{policy}"), "scenario": _text("{scenario}"), "actions": _actions}
    goals = {
        "matches": _text("{matches}"),
        "goal difference": _interval("goal_difference", "+.3f"),
        "won/drawn/lost": _text("{won}/{drawn}/{lost}"),
        "for": _text("{goals_for:.3f}"),
        "against": _text("{goals_against:.3f}"),
    }
    play = {
        "frames": _text("{length:.0f}"),
        "possession": _number("possession_share", ".0%"),
        "passes": _text("{passes:.2f}"),
        "shots": _text("{shots:.2f}"),
    }
    names = dict.fromkeys(name for row in results for name in row)
    for part in (name for name in names if name.startswith(_REWARD_PART)):
        heading = part.removeprefix(_REWARD_PART).replace("_", " ")
        # A part of one's own may be called what a statistic is.
        play[heading if heading not in who | play else f"reward {heading}"] = _number(part, "+.4f")
    seeds = {
        "configuration": _text("{configuration}"),
        "actions": _actions,
        "seeds": _text("{seeds}"),
        "scenarios": lambda row: str(len(row["scenarios"])),
        "goal difference": _interval("interquartile_mean", "+.3f"),
    }
    pairs = {
        "first": _text("{configuration}"),
        "second": _text("{over}"),
        "actions": _actions,
        "probability": _interval("probability", ".2f"),
    }
    trainings = {"run": _text("{policy}"), "frames": _text("{frames:,}")}
    if training:
        reached = training[0]["threshold"]
        kept = reached - training[0]["tolerance"]
        heading = f"frames until {reached:g} was reached and {kept:g} kept"
        trainings[heading] = _number("frames_until_threshold", ",", missing="never")
    heading = "goal difference of the last 100 training matches"
    trainings[heading] = _number("paper_goal_difference", "+.3f")
    improvement = "Probability that a seed of the first scores more than one of the second"
    interval = "95 % interval"
    return [
        (f"Goals per match (mean, {interval})", results, who | goals),
        ("Play per match (means)", results, who | play),
        (f"Goal difference over seeds (interquartile mean, {interval})", report["seeds"], seeds),
        (f"{improvement} ({interval})", report["improvements"], pairs),
        ("Training (from its log)", training, trainings),
    ]


def _text(form: str) -> Cell:
    return form.format_map


def _actions(row: Row) -> str:
    return {"sample": "sampled", "greedy": "greedy", None: ""}[row["mode"]]


def _number(name: str, form: str, missing: str = "") -> Cell:
    return lambda row: missing if row.get(name) is None else f"{row[name]:{form}}"


def _interval(name: str, form: str) -> Cell:
    def cell(row: Row) -> str:
        low, high = row[f"{name}_low"], row[f"{name}_high"]
        if low is None or high is None:
            return f"{row[name]:{form}} (one seed)"
        return f"{row[name]:{form}} [{low:{form}}, {high:{form}}]"

    return cell
