"""Bar charts of results per scenario and reward, with published numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fbrl.analysis import seed_statistics
from fbrl.analysis.results import Published, Result, ResultsError
from fbrl.figures.style import COLOURS, add_legend, count_frames, new_figure, set_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXIS_NAMES = {
    "goal-difference": "goal difference per match",
    "generalisation": "goal difference per match\nin a scenario not trained on",
}
_HATCH = "///"


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        scenario: The group of bars that it stands in.
        agent: What its colour stands for.
        reward: What the agent was trained with; decides the colour of published numbers.
        height: The mean of the seeds, for convergence their median; infinite if too many
            never got there.
        low: Lower end of the height's 95 % interval, if there is one.
        high: Upper end, likewise.
        values: What each seed has reached; empty for a published number.
    """

    scenario: str
    agent: str
    reward: str
    height: float
    low: float | None
    high: float | None
    values: tuple[float, ...]

    @property
    def reached(self) -> int:
        """Seeds with a finite value."""
        return sum(map(math.isfinite, self.values))


def pool_results(results: Iterable[Result], measure: str) -> list[Bar]:
    """Pools the seeds of each agent in each scenario.

    Goal differences give the mean with a bootstrap interval over the seeds, or, for a single seed,
    that seed's own interval over its matches. Frames until convergence give the median (of an even
    number of seeds the later one in the middle), for which a seed that never converges counts as
    later than all others; it has no interval.

    Args:
        results: In any order; the bars come in the order of the first of their results.
        measure: One of :data:`fbrl.analysis.results.MEASURES`.

    Raises:
        ResultsError: A seed comes twice.
    """
    pooled: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        pooled.setdefault((result.scenario, result.agent), []).append(result)
    bars = []
    for (scenario, agent), group in pooled.items():
        if len({result.seed for result in group}) < len(group):
            raise ResultsError(
                f"{agent} in {scenario} has two results of the same seed. Give each once; results "
                "of different configurations can't be pooled."
            )
        height, low, high = _pool(group, measure)
        values = tuple(result.value for result in group)
        bars.append(Bar(scenario, agent, group[0].reward, height, low, high, values))
    return bars


def published_bars(published: Iterable[Published], name: str, ours: Sequence[Bar]) -> list[Bar]:
    """Published numbers as bars, those of the scenarios that we have results of.

    Args:
        published: The numbers.
        name: Whose they are, for the legend.
        ours: Our bars.
    """
    scenarios = {bar.scenario for bar in ours}
    return [
        Bar(row.scenario, f"{row.reward} ({name})", row.reward, row.value, None, None, ())
        for row in published
        if row.scenario in scenarios
    ]


def bars_figure(bars: Sequence[Bar], measure: str, title: str) -> Figure:
    """Groups of bars, a group for each scenario and a colour for each agent.

    Published numbers are hatched, in the colour of ours with the same reward. Dots are seeds,
    where there are several. Where no bar can be drawn because the threshold was never reached, it
    says so.

    Args:
        bars: At least one; those of an agent stand in the same place in each group.
        measure: One of :data:`fbrl.analysis.results.MEASURES`.
        title: What is said of them.

    Raises:
        ImportError: matplotlib is not installed.
    """
    scenarios = list(dict.fromkeys(bar.scenario for bar in bars))
    agents = _places(bars)
    colours = _colours(bars)
    width = 0.8 / len(agents)
    size = max(7.0, 1.2 + 0.45 * len(scenarios) * (len(agents) + 1))
    figure, axes = new_figure(size, 4.2)
    for agent in agents:
        place = (agents.index(agent) - (len(agents) - 1) / 2) * width
        own = [bar for bar in bars if bar.agent == agent]
        at = np.array([scenarios.index(bar.scenario) + place for bar in own])
        _draw(axes, at, own, width, colours[agent])
    axes.set_xticks(range(len(scenarios)), [_short(scenario) for scenario in scenarios])
    axes.axhline(0, color="black", linewidth=0.8)
    name = AXIS_NAMES.get(measure)
    if name is None:
        finite = [value for bar in bars for value in (bar.height, *bar.values)]
        most = max((value for value in finite if math.isfinite(value)), default=0.0)
        name = f"convergence,\n{count_frames(axes.yaxis, most)}"
        axes.set_ylim(0, most * 1.08 or 1.0)
    set_labels(axes, title, "", name)
    add_legend(axes, _note(bars, measure))
    return figure


def _pool(group: Sequence[Result], measure: str) -> tuple[float, float | None, float | None]:
    values = [result.value for result in group]
    if measure == "convergence":
        # Of an even number the later one, as a mean with infinity would be none.
        return sorted(values)[len(values) // 2], None, None
    if len(group) == 1:
        return values[0], group[0].low, group[0].high
    estimate = seed_statistics.mean(np.array(values)[:, None])
    return estimate.value, estimate.low, estimate.high


def _places(bars: Sequence[Bar]) -> list[str]:
    """The agents in the order of their bars: published numbers follow ours of that reward."""
    ours = list(dict.fromkeys(bar.agent for bar in bars if bar.values))
    reward_of = {bar.agent: bar.reward for bar in bars}
    published = list(dict.fromkeys(bar.agent for bar in bars if not bar.values))
    places = []
    for index, agent in enumerate(ours):
        places.append(agent)
        rest = [reward_of[other] for other in ours[index + 1 :]]
        if reward_of[agent] not in rest:
            places += [name for name in published if reward_of[name] == reward_of[agent]]
    return places + [name for name in published if name not in places]


def _colours(bars: Sequence[Bar]) -> dict[str, str]:
    colours: dict[str, str] = {}
    of_reward: dict[str, str] = {}
    for bar in sorted(bars, key=lambda bar: not bar.values):
        if bar.agent not in colours:
            fresh = COLOURS[len(set(colours.values())) % len(COLOURS)]
            colours[bar.agent] = fresh if bar.values else of_reward.get(bar.reward, fresh)
            of_reward.setdefault(bar.reward, colours[bar.agent])
    return colours


def _draw(axes: Axes, at: np.ndarray, bars: Sequence[Bar], width: float, colour: str) -> None:
    is_published = not bars[0].values
    heights = [bar.height if math.isfinite(bar.height) else 0.0 for bar in bars]
    axes.bar(
        at,
        heights,
        width * 0.92,
        color="white" if is_published else colour,
        edgecolor=colour,
        hatch=_HATCH if is_published else None,
        label=bars[0].agent,
    )
    for x, bar in zip(at, bars, strict=True):
        if bar.low is not None and bar.high is not None:
            ends = [[max(0.0, bar.height - bar.low)], [max(0.0, bar.high - bar.height)]]
            axes.errorbar(x, bar.height, ends, color="black", capsize=3, linewidth=1.2)
        if len(bar.values) > 1:
            finite = [value for value in bar.values if math.isfinite(value)]
            axes.plot(
                [x - width / 5] * len(finite),
                finite,
                "o",
                color="#333333",
                markersize=3.5,
                alpha=0.7,
            )
        if bar.reached < len(bar.values):
            _say_reached(axes, x, bar)


def _say_reached(axes: Axes, x: float, bar: Bar) -> None:
    several = len(bar.values) > 1
    text = f"{bar.reached} of {len(bar.values)} seeds" if several else "not reached"
    height = max((value for value in bar.values if math.isfinite(value)), default=0.0)
    axes.annotate(
        text, (x, height), xytext=(0, 5), textcoords="offset points", rotation=90, ha="center",
        va="bottom", fontsize=9,
    )  # fmt: skip


def _short(scenario: str) -> str:
    words = scenario.removeprefix("academy_").split("_")
    half = (len(words) + 1) // 2
    return f"{' '.join(words[:half])}\n{' '.join(words[half:])}".strip()


def _note(bars: Sequence[Bar], measure: str) -> str | None:
    counts = {len(bar.values) for bar in bars if bar.values}
    if measure == "convergence":
        return "median of the seeds; dots: seeds" if max(counts) > 1 else None
    over = []
    if max(counts) > 1:
        over.append("over seeds (dots)")
    if 1 in counts:
        over.append("over the matches of one agent")
    return f"95 % intervals {', or '.join(over)}"
