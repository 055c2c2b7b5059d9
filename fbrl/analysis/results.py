"""Results of agents, one for each seed and scenario: from runs, from tables, and published ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fbrl.analysis.run_groups import RunGroup
from fbrl.analysis.run_log import GOAL_DIFFERENCE, RunLog, frames_until
from fbrl.checks.names import UnknownNameError, check_name
from fbrl.components import REWARDS
from fbrl.files.csv_table import as_number, read_csv_table
from fbrl.run_files import EVALUATIONS_NAME
from fbrl.scenarios import check_scenario

MEASURES = ("goal-difference", "convergence", "generalisation")
"""What the thesis compares: its Figures 6.1 to 6.3."""


_GOALS = ("goal_difference", "goal_difference_low", "goal_difference_high")


class ResultsError(ValueError):
    """Raised for a run without results, and for a table that is damaged or holds none."""


@dataclass(frozen=True)
class Result:
    """What one seed of an agent has reached in a scenario.

    Attributes:
        scenario: Where it played.
        agent: What was trained, or the name of a policy: one colour of a bar chart.
        reward: What it was trained with; empty for a policy that was not trained.
        seed: Of its training; None for a policy that was not trained.
        value: The goal difference, or the frames until convergence; infinite if never.
        low: Lower end of the value's 95 % interval over matches, if known.
        high: Upper end, likewise.
    """

    scenario: str
    agent: str
    reward: str
    seed: int | None
    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Published:
    """A number from elsewhere, to be drawn beside ours."""

    scenario: str
    reward: str
    value: float
    model: str = ""


THESIS = "thesis"
"""The name of the published numbers that fbrl ships."""


def final_goal_differences(groups: Iterable[RunGroup]) -> list[Result]:
    """The goal difference of each run in its last evaluation on fresh matches.

    Raises:
        ResultsError: A run was not evaluated.
    """
    return [_result(group, run, *_last_evaluation(run)) for group in groups for run in group.runs]


def convergence(
    groups: Iterable[RunGroup], threshold: float, tolerance: float = 0.0
) -> list[Result]:
    """The frames that each run took: see :func:`fbrl.analysis.run_log.frames_until`.

    Raises:
        UnknownNameError: A run has logged no goal difference.
    """
    results = []
    for group in groups:
        for run in group.runs:
            goals = run.metric(GOAL_DIFFERENCE)
            frames = frames_until(run.frames, goals, threshold, tolerance)
            results.append(_result(group, run, math.inf if frames is None else frames))
    return results


def read_evaluation_table(path: Path, measure: str, mode: str) -> list[Result]:
    """Goal differences of a table that ``fbrl-eval --csv`` has written.

    Args:
        path: The table. It has the columns ``policy``, ``configuration``, ``reward``,
            ``trained_on``, ``seed``, ``scenario``, ``mode``, ``goal_difference``,
            ``goal_difference_low`` and ``goal_difference_high``, among others.
        measure: ``goal-difference`` takes the scenarios that agents were trained on,
            ``generalisation`` the others. Policies that were not trained are in both.
        mode: ``sample`` or ``greedy``: how trained agents chose their actions.

    Raises:
        ResultsError: The table is missing, damaged, or has no such rows.
    """
    rows = _read_rows(
        path, ("policy", "configuration", "reward", "trained_on", "seed", "mode", *_GOALS)
    )
    chosen = [
        row
        for row in rows
        if not row["trained_on"]
        or (
            row["mode"] == mode
            and (row["scenario"] == row["trained_on"]) == (measure == "goal-difference")
        )
    ]
    if not any(row["trained_on"] for row in chosen):
        where = "the" if measure == "goal-difference" else "another than the"
        raise ResultsError(
            f"{path} has no row of a trained agent that plays {where} scenario it was trained "
            f"on in the mode {mode}; there are {len(rows)} other rows."
        )
    trained_on = {row["trained_on"] for row in chosen if row["trained_on"]}
    return [_table_result(path, row, len(trained_on) > 1) for row in chosen]


def read_published(path: Path, measure: str) -> list[Published]:
    """Numbers from elsewhere, such as those of a publication.

    Args:
        path: :data:`THESIS`, or a table with the columns ``scenario``, ``reward`` and ``value``,
            and, where it has more than one measure, ``measure``; ``model`` says whose a number is.
            Values are goal differences per match, or environment frames for the measure
            convergence.
        measure: The rows that are taken, if the table has that column.

    Raises:
        ResultsError: The table is missing or damaged, or has no row of the measure.
        UnknownNameError: A scenario, reward or measure in it does not exist.
    """
    if str(path) == THESIS:
        path = Path(__file__).with_name("thesis.csv")
    rows = _read_rows(path, ("reward", "value"))
    for row in rows:
        try:
            REWARDS.check(row["reward"])
            check_name("measure", row.get("measure", measure), MEASURES)
        except UnknownNameError as error:
            raise UnknownNameError(f"{path}: {error}") from error
    chosen = [row for row in rows if row.get("measure", measure) == measure]
    if not chosen:
        raise ResultsError(f"{path} has no row of the measure {measure}.")
    return [
        Published(row["scenario"], row["reward"], _number(path, row, "value"), row.get("model", ""))
        for row in chosen
    ]


def _last_evaluation(run: RunLog) -> tuple[float, float, float]:
    names = [f"evaluation/{name}" for name in _GOALS]
    if not all(len(run.evaluations.get(name, ())) for name in names):
        raise ResultsError(
            f"{run.run_dir} has no evaluation on fresh matches in {EVALUATIONS_NAME}. Evaluate it "
            "with fbrl-eval --csv FILE and give that table instead."
        )
    value, low, high = (float(run.evaluations[name][-1]) for name in names)
    return value, low, high


def _result(
    group: RunGroup, run: RunLog, value: float, low: float | None = None, high: float | None = None
) -> Result:
    config = run.config
    return Result(config.scenario, group.label, config.reward, config.seed, value, low, high)


def _read_rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    try:
        table = read_csv_table(path)
    except OSError as error:
        raise ResultsError(f"{path} cannot be read as a table ({error}).") from error
    except ValueError as error:
        raise ResultsError(str(error)) from error
    missing = [name for name in ("scenario", *columns) if name not in table.columns]
    if missing:
        raise ResultsError(f"{path} has no column {' and no '.join(missing)}.")
    for line, row in zip(table.lines, table.rows, strict=True):
        try:
            check_scenario(row["scenario"])
        except UnknownNameError as error:
            raise UnknownNameError(f"{path}, line {line}: {error}") from error
    return table.rows


def _number(path: Path, row: Mapping[str, str], column: str) -> float:
    try:
        number = as_number(row[column])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ResultsError(f"{path} has {row[column]!r} as {column}, which is no finite number.")
    return number


def _table_result(path: Path, row: Mapping[str, str], name_scenario: bool) -> Result:
    goals = (_number(path, row, name) for name in _GOALS)
    if not row["trained_on"]:
        return Result(row["scenario"], row["policy"], "", None, *goals)
    agent = row["configuration"]
    if name_scenario:
        agent += f", from {row['trained_on']}"
    seed = int(_number(path, row, "seed"))
    return Result(row["scenario"], agent, row["reward"], seed, *goals)
