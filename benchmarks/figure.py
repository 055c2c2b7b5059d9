"""The results as one picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import sections
from benchmarks.results import SectionResults, Summary
from benchmarks.sections import FRAMES, STEPS
from benchmarks.tables import PEERS, mean_shares

_LABELS = {
    sections.THREE_VS_ONE: "3 against 1",
    sections.COUNTERATTACK: "counterattack",
    sections.FULL_MATCH: "11 against 11",
}


def save_figure(results: Mapping[str, SectionResults], path: Path) -> None:
    """Draws the sections that were measured, as PNG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    drawn = [section for section in _PANELS if section in results]
    if not drawn:
        return
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(6 * min(2, len(drawn)), 3.8 * ((len(drawn) + 1) // 2)))
        for index, section in enumerate(drawn):
            axes = figure.add_subplot((len(drawn) + 1) // 2, min(2, len(drawn)), index + 1)
            _PANELS[section](axes, results[section])
        figure.tight_layout()
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)


def _environment(axes: Any, result: SectionResults) -> None:
    bars = {
        name: [result.summary(case, name, STEPS, PEERS[name]) for case in result.cases]
        for name in (sections.MINIMAP, sections.SIMPLE115, sections.TRAINING_ENV)
    }
    _grouped_bars(axes, result.cases, bars)
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_title("Steps per second of one core, times those of gfootball's own")


def _training(axes: Any, result: SectionResults) -> None:
    names = [sections.FBRL, sections.PEER, sections.PEER + sections.ON_OUR_ENGINE]
    bars = {name: [result.summary(case, name, FRAMES) for case in result.cases] for name in names}
    _grouped_bars(axes, result.cases, bars)
    axes.set_title("Frames per second of a training")


def _vectorisation(axes: Any, result: SectionResults) -> None:
    for name in result.names:
        summaries = [(case, result.summary(case, name, FRAMES)) for case in result.cases]
        known = [(int(case), summary) for case, summary in summaries if summary]
        _error_bars(axes.errorbar, [case for case, _ in known], [s for _, s in known], label=name)
    axes.set_xscale("log", base=2)
    axes.set_xticks([int(case) for case in result.cases], result.cases)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("matches")
    axes.set_title("Frames per second of collection with the MLP")
    axes.legend(frameon=False)


def _time_shares(axes: Any, result: SectionResults) -> None:
    shares = {case: mean_shares(result, case) for case in result.cases}
    labels = [_label(case) for case in shares]
    left = np.zeros(len(shares))
    for index, part in enumerate(next(iter(shares.values()))):
        widths = [shares[case][part] for case in shares]
        colour = f"C{index}" if index < 10 else "grey"
        axes.barh(labels, widths, left=left, label=part, color=colour)
        left = left + widths
    axes.set_xlim(0, 100)
    axes.set_title("Where the time of a training goes, percent")
    _legend_below(axes)


def _grouped_bars(axes: Any, cases: list[str], bars: Mapping[str, list[Summary | None]]) -> None:
    width = 0.8 / len(bars)
    for index, (name, summaries) in enumerate(bars.items()):
        known = [(n + index * width, s) for n, s in enumerate(summaries) if s]
        if known:
            x, drawn = zip(*known, strict=True)
            _error_bars(axes.bar, x, drawn, label=name, width=width)
    middle = 0.8 / 2 - width / 2
    axes.set_xticks([n + middle for n in range(len(cases))], [_label(case) for case in cases])
    _legend_below(axes)


def _legend_below(axes: Any) -> None:
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14)}
    axes.legend(frameon=False, fontsize=7, ncols=3, **place)


def _error_bars(
    draw: Any, x: Sequence[float], summaries: Sequence[Summary], **options: Any
) -> None:
    """Medians, with lines from the lowest to the highest value."""
    medians = [s.median for s in summaries]
    below = [s.median - s.low for s in summaries]
    above = [s.high - s.median for s in summaries]
    draw(x, medians, yerr=[below, above], capsize=2, **options)


def _label(case: str) -> str:
    for scenario, label in _LABELS.items():
        case = case.replace(scenario, label)
    return case.replace(", ", "\n")


_PANELS: Mapping[str, Callable[[Any, SectionResults], None]] = {
    "environment": _environment,
    "vectorisation": _vectorisation,
    "training": _training,
    "time_shares": _time_shares,
}
