"""Bar charts of results per scenario and reward, with published numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fbrl.analysis.results import PooledResult
from fbrl.figures.style import COLOURS, add_legend, count_frames, new_figure, set_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXIS_NAMES = {
    "goal-difference": "goal difference per match",
    "generalisation": "goal difference per match\nin a scenario not trained on",
}


def bars_figure(bars: Sequence[PooledResult], measure: str, title: str) -> Figure:
    """Groups of bars, a group for each scenario and a colour for each agent.

    Published numbers are hatched, in the colour of ours with the same reward. Dots are seeds,
    where there are several. Where no bar can be drawn because the threshold was never reached, it
    says so.

    Args:
        bars: At least one; those of an agent stand in the same place in each group.
        measure: One of :data:`fbrl.analysis.results.MEASURES`.
        title: What is said of them.

    Raises:
        MissingExtraError: matplotlib is not installed.
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
        finite = [value for bar in bars for value in (bar.value, *bar.values)]
        most = max((value for value in finite if math.isfinite(value)), default=0.0)
        name = f"convergence,\n{count_frames(axes.yaxis, most)}"
        axes.set_ylim(0, most * 1.08 or 1.0)
    set_labels(axes, title, "", name)
    add_legend(axes, _note(bars, measure))
    return figure


def _places(bars: Sequence[PooledResult]) -> list[str]:
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


def _colours(bars: Sequence[PooledResult]) -> dict[str, str]:
    colours: dict[str, str] = {}
    of_reward: dict[str, str] = {}
    for bar in sorted(bars, key=lambda bar: not bar.values):
        if bar.agent not in colours:
            fresh = COLOURS[len(set(colours.values())) % len(COLOURS)]
            colours[bar.agent] = fresh if bar.values else of_reward.get(bar.reward, fresh)
            of_reward.setdefault(bar.reward, colours[bar.agent])
    return colours


def _draw(
    axes: Axes, at: np.ndarray, bars: Sequence[PooledResult], width: float, colour: str
) -> None:
    is_published = not bars[0].values
    heights = [bar.value if math.isfinite(bar.value) else 0.0 for bar in bars]
    axes.bar(
        at,
        heights,
        width * 0.92,
        color="white" if is_published else colour,
        edgecolor=colour,
        hatch="///" if is_published else None,
        label=bars[0].agent,
    )
    for x, bar in zip(at, bars, strict=True):
        if bar.low is not None and bar.high is not None:
            ends = [[max(0.0, bar.value - bar.low)], [max(0.0, bar.high - bar.value)]]
            axes.errorbar(x, bar.value, ends, color="black", capsize=3, linewidth=1.2)
        finite = [value for value in bar.values if math.isfinite(value)]
        if len(bar.values) > 1:
            dots = [x - width / 5] * len(finite)
            axes.plot(dots, finite, "o", color="#333333", markersize=3.5, alpha=0.7)
        if bar.reached < len(bar.values):
            several = len(bar.values) > 1
            said = f"{bar.reached} of {len(bar.values)} seeds" if several else "not reached"
            axes.annotate(
                said, (x, max(finite, default=0.0)), xytext=(0, 5), textcoords="offset points",
                rotation=90, ha="center", va="bottom", fontsize=9,
            )  # fmt: skip


def _short(scenario: str) -> str:
    words = scenario.removeprefix("academy_").split("_")
    half = (len(words) + 1) // 2
    return f"{' '.join(words[:half])}\n{' '.join(words[half:])}".strip()


def _note(bars: Sequence[PooledResult], measure: str) -> str | None:
    counts = {len(bar.values) for bar in bars if bar.values}
    if measure == "convergence":
        return "median of the seeds; dots: seeds" if max(counts) > 1 else None
    over = []
    if max(counts) > 1:
        over.append("over seeds (dots)")
    if 1 in counts:
        over.append("over the matches of one agent")
    return f"means and 95 % intervals {', or '.join(over)}"
