"""The results as Markdown, put between markers of a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks import sections
from benchmarks.markdown import format_number, format_summary, markdown_table
from benchmarks.measure_time_shares import OTHER
from benchmarks.results import SectionResults
from benchmarks.sections import FRAMES, RESETS, STEPS
from benchmarks.targets import targets_table

PEERS = {
    sections.MINIMAP: sections.SMM,
    sections.SIMPLE115: sections.SIMPLE115V2,
    sections.TRAINING_ENV: sections.STACKED_SMM,
    sections.SMM + sections.ON_OUR_ENGINE: sections.SMM,
    sections.SIMPLE115V2 + sections.ON_OUR_ENGINE: sections.SIMPLE115V2,
}
"""What each environment is compared with."""


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


def _engine(result: SectionResults) -> str:
    ours, default = sections.ENGINE, sections.ENGINE_BY_DEFAULT
    rows = [
        [
            case,
            format_summary(result.summary(case, ours, STEPS)),
            format_summary(result.summary(case, ours, RESETS)),
            format_summary(result.summary(case, ours, FRAMES)),
            format_summary(result.ratio(case, ours, default, FRAMES)),
            format_summary(result.summary(case, sections.COLLECTION, FRAMES)),
            format_summary(result.ratio(case, sections.COLLECTION, ours, FRAMES)),
        ]
        for case in result.cases
    ]
    header = [
        "scenario",
        "bare engine, steps/s",
        "resets/s",
        "frames/s, resets included",
        "times the default build",
        "collection with the MLP, frames/s",
        "share of the bare engine",
    ]
    return markdown_table(header, rows)


def _environment(result: SectionResults) -> str:
    rows = [
        [
            case,
            name,
            format_summary(result.summary(case, name, STEPS)),
            format_summary(result.summary(case, name, RESETS)),
            PEERS.get(name, "-"),
            format_summary(result.ratio(case, name, PEERS[name], STEPS)) if name in PEERS else "-",
        ]
        for case in result.cases
        for name in result.names
    ]
    header = [
        "scenario",
        "environment",
        "steps/s",
        "resets/s",
        "compared with",
        "times its steps/s",
    ]
    return markdown_table(header, rows)


def _vectorisation(result: SectionResults) -> str:
    rows = [
        [case, *(format_summary(result.summary(case, name, FRAMES)) for name in result.names)]
        for case in result.cases
    ]
    return markdown_table(["matches", *(f"{name}, frames/s" for name in result.names)], rows)


def _many_cores(result: SectionResults) -> str:
    rows = [
        [
            case,
            format_summary(result.summary(case, sections.FBRL, FRAMES)),
            format_summary(result.summary(case, sections.FBRL, sections.SHARE)),
        ]
        for case in result.cases
    ]
    return markdown_table(["cores", "frames/s", "share of the engines alone"], rows)


def _training(result: SectionResults) -> str:
    fbrl, peer = sections.FBRL, sections.PEER
    on_ours = peer + sections.ON_OUR_ENGINE
    rows = [
        [
            case,
            format_summary(result.summary(case, fbrl, FRAMES)),
            format_summary(result.summary(case, peer, FRAMES)),
            format_summary(result.ratio(case, fbrl, peer, FRAMES)),
            format_summary(result.summary(case, on_ours, FRAMES)),
            format_summary(result.ratio(case, fbrl, on_ours, FRAMES)),
        ]
        for case in result.cases
    ]
    header = [
        "training",
        "fbrl, frames/s",
        f"{peer}, frames/s",
        "fbrl is faster by",
        f"{on_ours}, frames/s",
        "fbrl is faster by",
    ]
    return markdown_table(header, rows)


def mean_shares(result: SectionResults, case: str) -> dict[str, float]:
    """Mean share of each part in percent; unlike medians, means add up to 100."""
    parts = dict.fromkeys(row.figure for row in result.rows if row.case == case)
    means = {
        part: float(np.mean(list(result.by_round(case, sections.FBRL, part).values())))
        for part in parts
    }
    last = list(means).index(OTHER)
    return dict(list(means.items())[: last + 1])


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
