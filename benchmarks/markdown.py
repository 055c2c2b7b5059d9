"""Numbers and tables in Markdown."""

from __future__ import annotations

from benchmarks.results import Summary

NOT_MEASURED = "not measured"


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
