"""Figures of a run: kept as JSON, summed up over the rounds, and put into Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.rounds import Row

NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Summary:
    """Median, lowest and highest value over the rounds."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class SectionResults:
    """All figures that a section measured, and on what machine."""

    machine: Mapping[str, str | float]
    rows: list[Row]

    @property
    def cases(self) -> list[str]:
        """The cases, in the order in which they were measured."""
        return list(dict.fromkeys(row.case for row in self.rows))

    @property
    def names(self) -> list[str]:
        """The contestants, likewise."""
        return list(dict.fromkeys(row.name for row in self.rows))

    @property
    def rounds(self) -> int:
        """How often everything was measured."""
        return 1 + max(row.round for row in self.rows)

    def by_round(self, case: str, name: str, figure: str) -> dict[int, float]:
        """The values of a figure, by round."""
        wanted = (case, name, figure)
        return {r.round: r.value for r in self.rows if (r.case, r.name, r.figure) == wanted}

    def summary(self, case: str, name: str, figure: str, peer: str | None = None) -> Summary | None:
        """Sums up a figure, or its ratios to a peer's, each taken within a round.

        None where it was not measured.
        """
        values = self.by_round(case, name, figure)
        if peer is not None:
            theirs = self.by_round(case, peer, figure)
            values = {n: value / theirs[n] for n, value in values.items() if n in theirs}
        if not values:
            return None
        return Summary(
            float(np.median(list(values.values()))), min(values.values()), max(values.values())
        )


def load_results(path: Path) -> dict[str, SectionResults]:
    """Reads what :func:`save_results` wrote; nothing where there is no file."""
    if not path.exists():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    return {
        section: SectionResults(values["machine"], [Row(*row) for row in values["rows"]])
        for section, values in content.items()
    }


def save_results(results: Mapping[str, SectionResults], path: Path) -> None:
    """Writes all sections as JSON, a line for each row."""
    sections = []
    for section, result in results.items():
        rows = ",\n".join(f"      {json.dumps(list(asdict(row).values()))}" for row in result.rows)
        machine = json.dumps(result.machine)
        sections.append(
            f'  "{section}": {{\n    "machine": {machine},\n    "rows": [\n{rows}\n    ]\n  }}'
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("{\n" + ",\n".join(sections) + "\n}\n", encoding="utf-8")


def format_number(value: float) -> str:
    """Three significant digits or more, and thousands apart."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def format_summary(summary: Summary | None, unit: str = "") -> str:
    """Median, and the lowest and highest in brackets."""
    if summary is None:
        return NOT_MEASURED
    low, high = format_number(summary.low), format_number(summary.high)
    return f"{format_number(summary.median)}{unit} [{low}, {high}]"


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
