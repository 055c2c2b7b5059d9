"""Figures of a run: kept as JSON, and summed up over the rounds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.rounds import Row


@dataclass(frozen=True)
class Summary:
    """Median, lowest and highest value over the rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: list[float]) -> Summary:
        """Sums up at least one value."""
        return cls(float(np.median(values)), min(values), max(values))


@dataclass(frozen=True)
class SectionResults:
    """What a section measured, and on what machine.

    Attributes:
        machine: As :func:`benchmarks.machine.describe_machine` returns it.
        rows: All figures of all rounds.
    """

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

    def summary(self, case: str, name: str, figure: str) -> Summary | None:
        """Sums up a figure; None where it was not measured."""
        values = list(self.by_round(case, name, figure).values())
        return Summary.of(values) if values else None

    def ratio(self, case: str, name: str, peer: str, figure: str) -> Summary | None:
        """Sums up the ratios of a contestant to another one, each taken within a round."""
        ours, theirs = self.by_round(case, name, figure), self.by_round(case, peer, figure)
        ratios = [ours[number] / theirs[number] for number in ours if number in theirs]
        return Summary.of(ratios) if ratios else None


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
