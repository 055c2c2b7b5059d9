"""Results of agents: from runs, from tables and published ones, and their seeds pooled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fbrl.analysis.run_groups import RunGroup
from fbrl.analysis.run_log import GOAL_DIFFERENCE, RunLog, frames_until
from fbrl.analysis.seed_statistics import mean
from fbrl.checks import UnknownNameError, check_name
from fbrl.components import REWARDS
from fbrl.files.csv_table import as_number, read_csv_table
from fbrl.run_files import EVALUATIONS_NAME
from fbrl.scenarios import check_scenario

MEASURES = ("goal-difference", "convergence", "generalisation")
"""What the thesis compares: its Figures 6.1 to 6.3."""

THESIS = "thesis"
"""The name of the published numbers that fbrl ships."""

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


@dataclass(frozen=True)
class PooledResult:
    """What the seeds of an agent have reached together in a scenario, or a published number.

    Attributes:
        agent: As in :class:`Result`, or where a published number is from.
        value: The mean of the seeds, for convergence their median; infinite if too many never got
            there.
        low: Lower end of the value's 95 % interval, if there is one.
        high: Upper end, likewise.
        values: What each seed has reached; empty for a published number.
    """

    scenario: str
    agent: str
    reward: str
    value: float
    low: float | None = None
    high: float | None = None
    values: tuple[float, ...] = ()

    @property
    def reached(self) -> int:
        """Seeds with a finite value."""
        return sum(map(math.isfinite, self.values))


def final_goal_differences(groups: Iterable[RunGroup]) -> list[Result]:
    """The goal difference of each run in its last evaluation on fresh matches.

    Raises:
        ResultsError: A run was not evaluated.
    """
    names = [f"evaluation/{name}" for name in _GOALS]
    results = []
    for group in groups:
        for run in group.runs:
            if not all(len(run.evaluations.get(name, ())) for name in names):
                raise ResultsError(
                    f"{run.run_dir} has no evaluation on fresh matches in {EVALUATIONS_NAME}. "
                    "Evaluate it with fbrl-eval --csv FILE and give that table instead."
                )
            latest = (float(run.evaluations[name][-1]) for name in names)
            results.append(_result(group, run, *latest))
    return results


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


def _result(
    group: RunGroup, run: RunLog, value: float, low: float | None = None, high: float | None = None
) -> Result:
    config = run.config
    return Result(config.scenario, group.label, config.reward, config.seed, value, low, high)


def read_evaluation_table(path: Path, measure: str, mode: str) -> list[Result]:
    """Goal differences of a table that ``fbrl-eval --csv`` has written.

    Args:
        path: The table.
        measure: ``goal-difference`` takes the scenarios that agents were trained on,
            ``generalisation`` the others. Policies that were not trained are in both.
        mode: ``sample`` or ``greedy``: how trained agents chose their actions.

    Raises:
        ResultsError: The table is missing, damaged, or has no such rows.
    """
    rows = _read_rows(
        path, ("policy", "configuration", "reward", "trained_on", "seed", "mode", *_GOALS)
    )
    at_home = measure == "goal-difference"
    chosen = [
        row
        for row in rows
        if not row["trained_on"]
        or (row["mode"] == mode and (row["scenario"] == row["trained_on"]) == at_home)
    ]
    trained_on = {row["trained_on"] for row in chosen} - {""}
    if not trained_on:
        raise ResultsError(
            f"{path} has no row of a trained agent that plays "
            f"{'the' if at_home else 'another than the'} scenario it was trained on in the mode "
            f"{mode}; there are {len(rows)} other rows."
        )
    return [_table_result(path, row, not at_home and len(trained_on) > 1) for row in chosen]


def _table_result(path: Path, row: Mapping[str, str], name_scenario: bool) -> Result:
    goals = (_number(path, row, name) for name in _GOALS)
    if not row["trained_on"]:
        return Result(row["scenario"], row["policy"], "", None, *goals)
    agent = row["configuration"]
    if name_scenario:
        agent += f", from {row['trained_on']}"
    seed = int(_number(path, row, "seed"))
    return Result(row["scenario"], agent, row["reward"], seed, *goals)


def read_published(path: Path, measure: str) -> list[Published]:
    """Numbers from elsewhere, such as those of a publication.

    Args:
        path: :data:`THESIS`, or a table with the columns ``scenario``, ``reward`` and ``value``
            (goal differences per match, or frames for the measure convergence) and, where it has
            more than one measure, ``measure``; ``model`` says whose a number is.
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


def pool_results(results: Iterable[Result], measure: str) -> list[PooledResult]:
    """Pools the seeds of each agent in each scenario, in the order of their first results.

    Goal differences give the plain mean, as publications report it for a scenario, with a
    bootstrap interval over the seeds or, for a single seed, its own interval over its matches;
    :func:`fbrl.evaluation.comparison.pool_seeds` gives the interquartile mean over seeds and
    scenarios together. Frames until convergence give the median, for which a seed that never
    converges counts as later than all others; it has no interval.

    Raises:
        ResultsError: A seed comes twice.
    """
    pooled: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        pooled.setdefault((result.scenario, result.agent), []).append(result)
    found = []
    for (scenario, agent), group in pooled.items():
        if len({result.seed for result in group}) < len(group):
            raise ResultsError(
                f"{agent} in {scenario} has two results of the same seed. Give each once; results "
                "of different configurations can't be pooled."
            )
        values = tuple(result.value for result in group)
        if measure == "convergence":
            # Of an even number the later one, as a mean with infinity would be none.
            value, low, high = sorted(values)[len(values) // 2], None, None
        elif len(group) == 1:
            value, low, high = values[0], group[0].low, group[0].high
        else:
            estimate = mean([[value] for value in values])
            value, low, high = estimate.value, estimate.low, estimate.high
        found.append(PooledResult(scenario, agent, group[0].reward, value, low, high, values))
    return found


def published_beside(
    ours: Sequence[PooledResult], published: Iterable[Published], name: str
) -> list[PooledResult]:
    """Published numbers as results, those of the scenarios that we have results of.

    Args:
        ours: Our results.
        published: The numbers.
        name: Whose they are that don't say it themselves.
    """
    scenarios = {result.scenario for result in ours}
    return [
        PooledResult(row.scenario, f"{row.reward} ({row.model or name})", row.reward, row.value)
        for row in published
        if row.scenario in scenarios
    ]
