"""Results of several seeds as one, with published numbers beside them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fbrl.analysis import seed_statistics
from fbrl.analysis.results import Published, Result, ResultsError


@dataclass(frozen=True)
class PooledResult:
    """What the seeds of an agent have reached together in a scenario, or a published number.

    Attributes:
        scenario: Where it played.
        agent: What was trained, the name of a policy, or where a published number is from.
        reward: What it was trained with; empty for a policy that was not trained.
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
    low: float | None
    high: float | None
    values: tuple[float, ...]

    @property
    def reached(self) -> int:
        """Seeds with a finite value."""
        return sum(map(math.isfinite, self.values))


def pool_results(results: Iterable[Result], measure: str) -> list[PooledResult]:
    """Pools the seeds of each agent in each scenario.

    Goal differences give the mean with a bootstrap interval over the seeds, or, for a single seed,
    that seed's own interval over its matches. It is the plain mean, as publications report it for a
    scenario; :func:`fbrl.evaluation.comparison.pool_seeds` gives the interquartile mean over
    seeds and scenarios together. Frames until convergence give the median (of an even
    number of seeds the later one in the middle), for which a seed that never converges counts as
    later than all others; it has no interval.

    Args:
        results: In any order; pooled, they come in the order of their first ones.
        measure: One of :data:`fbrl.analysis.results.MEASURES`.

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
        value, low, high = _pool(group, measure)
        values = tuple(result.value for result in group)
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
    beside = [row for row in published if row.scenario in scenarios]
    agents = [f"{row.reward} ({row.model or name})" for row in beside]
    return [
        PooledResult(row.scenario, agent, row.reward, row.value, None, None, ())
        for row, agent in zip(beside, agents, strict=True)
    ]


def _pool(group: Sequence[Result], measure: str) -> tuple[float, float | None, float | None]:
    values = [result.value for result in group]
    if measure == "convergence":
        # Of an even number the later one, as a mean with infinity would be none.
        return sorted(values)[len(values) // 2], None, None
    if len(group) == 1:
        return values[0], group[0].low, group[0].high
    estimate = seed_statistics.mean(np.array(values)[:, None])
    return estimate.value, estimate.low, estimate.high
