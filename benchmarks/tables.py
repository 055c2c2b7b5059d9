"""The results as Markdown, put between markers of a page."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks import sections
from benchmarks.measure_time_shares import OTHER
from benchmarks.results import (
    SectionResults,
    format_number,
    format_summary,
    markdown_table,
)
from benchmarks.sections import FBRL, FRAMES, PEER, RESETS, STEPS
from benchmarks.targets import targets_table

PEERS = {
    sections.MINIMAP: sections.SMM,
    sections.SIMPLE115: sections.SIMPLE115V2,
    sections.TRAINING_ENV: sections.STACKED_SMM,
    sections.SMM + sections.ON_OUR_ENGINE: sections.SMM,
    sections.SIMPLE115V2 + sections.ON_OUR_ENGINE: sections.SIMPLE115V2,
}
"""What each environment is compared with."""

Column = tuple[str, str, str] | tuple[str, str, str, str]
"""A heading, and what is below it: a contestant's figure, perhaps divided by a peer's."""


def write_page(results: Mapping[str, SectionResults], page: Path) -> None:
    """Replaces what lies between the markers of each section; adds markers that are missing."""
    text = page.read_text(encoding="utf-8") if page.exists() else "# Performance\n"
    tables = {
        section: f"{TABLES[section](result)}\n\n{_caption(result)}"
        for section, result in results.items()
    }
    for name, table in {"targets": targets_table(results), **tables}.items():
        begin, end = f"<!-- benchmark: {name} -->", f"<!-- end of benchmark: {name} -->"
        if begin not in text:
            text += f"\n{begin}\n{end}\n"
        before, _, rest = text.partition(begin)
        _, _, after = rest.partition(end)
        text = f"{before}{begin}\n{table}\n{end}{after}"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")


def _caption(result: SectionResults) -> str:
    machine = result.machine
    return (
        f"Median [lowest, highest] of {result.rounds} round(s); {machine['processor']}, "
        f"{machine['cores']} cores, GPU {machine['GPU']}, load before the run "
        f"{machine['load before the run']}, {machine['date']}, commit {machine['commit']}."
    )


def _by_case(result: SectionResults, first: str, columns: Sequence[Column]) -> str:
    """A row for each case, and a figure of it for each column."""
    rows = [
        [case, *(format_summary(result.summary(case, *figure)) for _, *figure in columns)]
        for case in result.cases
    ]
    return markdown_table([first, *(heading for heading, *_ in columns)], rows)


def _engine(result: SectionResults) -> str:
    ours, collection = sections.ENGINE, sections.COLLECTION
    columns: list[Column] = [
        ("bare engine, steps/s", ours, STEPS),
        ("resets/s", ours, RESETS),
        ("frames/s, resets included", ours, FRAMES),
        ("times the default build", ours, FRAMES, sections.ENGINE_BY_DEFAULT),
        ("collection with the MLP, frames/s", collection, FRAMES),
        ("share of the bare engine", collection, FRAMES, ours),
    ]
    return _by_case(result, "scenario", columns)


def _environment(result: SectionResults) -> str:
    rows = []
    for case, name in itertools.product(result.cases, result.names):
        peer = PEERS.get(name)
        steps = format_summary(result.summary(case, name, STEPS))
        resets = format_summary(result.summary(case, name, RESETS))
        times = format_summary(result.summary(case, name, STEPS, peer)) if peer else "-"
        rows.append([case, name, steps, resets, peer or "-", times])
    header = ["scenario", "environment", "steps/s", "resets/s", "compared with"]
    return markdown_table([*header, "times its steps/s"], rows)


def _vectorisation(result: SectionResults) -> str:
    columns: list[Column] = [(f"{name}, frames/s", name, FRAMES) for name in result.names]
    return _by_case(result, "matches", columns)


def _many_cores(result: SectionResults) -> str:
    columns: list[Column] = [
        ("frames/s", FBRL, FRAMES),
        ("share of the engines alone", FBRL, sections.SHARE),
    ]
    return _by_case(result, "cores", columns)


def _training(result: SectionResults) -> str:
    on_ours = PEER + sections.ON_OUR_ENGINE
    columns: list[Column] = [
        ("fbrl, frames/s", FBRL, FRAMES),
        (f"{PEER}, frames/s", PEER, FRAMES),
        ("fbrl is faster by", FBRL, FRAMES, PEER),
        (f"{on_ours}, frames/s", on_ours, FRAMES),
        ("fbrl is faster by", FBRL, FRAMES, on_ours),
        ("fbrl in bfloat16, frames/s", FBRL + sections.IN_BFLOAT16, FRAMES),
        (f"it is faster than {PEER} by", FBRL + sections.IN_BFLOAT16, FRAMES, PEER),
    ]
    return _by_case(result, "training", columns)


def mean_shares(result: SectionResults, case: str) -> dict[str, float]:
    """Mean share of each part in percent; unlike medians, means add up to 100."""
    parts = list(dict.fromkeys(row.figure for row in result.rows if row.case == case))
    return {
        part: float(np.mean(list(result.by_round(case, FBRL, part).values())))
        for part in parts[: parts.index(OTHER) + 1]
    }


def _time_shares(result: SectionResults) -> str:
    shares = {case: mean_shares(result, case) for case in result.cases}
    parts = list(next(iter(shares.values())))
    rows = [[part, *(f"{shares[case][part]:.1f} %" for case in shares)] for part in parts]
    rows.append(["together", *(f"{sum(shares[case].values()):.1f} %" for case in shares)])
    return markdown_table(["part", *shares], rows)


def _memory(result: SectionResults) -> str:
    rows = [[r.name, r.figure.replace("_", " "), format_number(r.value)] for r in result.rows]
    return markdown_table(["what", "figure", "value"], rows)


TABLES: Mapping[str, Callable[[SectionResults], str]] = {
    "engine": _engine,
    "environment": _environment,
    "vectorisation": _vectorisation,
    "many_cores": _many_cores,
    "training": _training,
    "time_shares": _time_shares,
    "memory": _memory,
}
