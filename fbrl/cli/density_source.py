"""Reads the passes that ``fbrl-density``'s options ask for, with progress on the screen."""

from __future__ import annotations

import argparse
import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fbrl.density.filters import PassFilter, count_groups
from fbrl.density.passes import Pass, Passes, clean
from fbrl.density.statsbomb import StatsBombSource
from fbrl.density.tables import read_event_files, read_passes_csv


@dataclass(frozen=True)
class Reading:
    """Passes and what is said of them.

    Attributes:
        rows: the passes that are left.
        counts: how many there are of each competition and season.
        description: which they are, in words.
        notes: what was left out, and why.
    """

    rows: Sequence[Pass]
    counts: dict[str, int]
    description: str
    notes: Sequence[str]


def read_passes(options: argparse.Namespace, chosen: PassFilter) -> Reading:
    """Reads, filters and cleans the passes.

    Raises:
        ValueError: if the options contradict each other, or the source is damaged.
        OSError: if the source cannot be read.
    """
    downloads = options.competition or options.season
    given = [name for name in ("csv", "events") if getattr(options, name) is not None]
    if len(given) + bool(downloads) != 1:
        raise ValueError(
            "Give one source: --competition with --season, or --csv FILE, or --events DIR."
        )
    notes: list[str] = []
    if options.csv is not None:
        passes = read_passes_csv(options.csv)
    elif options.events is not None:
        passes = read_event_files(options.events)
    else:
        passes = _download(options, notes)
    if chosen.name is None and chosen.resolved_name(passes) == "all":
        notes.append(f"{passes.origin} has no play_pattern: no pass is left out for it.")
    rows = chosen(passes)
    cleaned = clean(dataclasses.replace(passes, rows=rows), drop_unusable=options.drop_unusable)
    if cleaned.unusable:
        notes.append(f"{cleaned.unusable} passes at NaN or outside the pitch were left out.")
    if cleaned.repeated:
        notes.append(f"{cleaned.repeated} passes were listed twice and are counted once.")
    return Reading(cleaned.rows, count_groups(cleaned.rows), chosen.describe(passes), notes)


def _download(options: argparse.Namespace, notes: list[str]) -> Passes:
    competitions, seasons = options.competition or [], options.season or []
    if len(competitions) != len(seasons):
        raise ValueError(
            f"{len(competitions)} --competition but {len(seasons)} --season: give each competition "
            "its season, also where it is the same one."
        )
    if options.jobs < 1:
        raise ValueError(f"--jobs is {options.jobs}; it must be at least 1.")
    source = StatsBombSource(workers=options.jobs, refresh=options.refresh)
    screen = Console(stderr=True)
    with Progress(
        TextColumn("Reading matches"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=screen,
        transient=True,
        # Where nobody watches, it would leave an empty line.
        disable=not screen.is_terminal,
    ) as progress:
        bar = progress.add_task("", total=None)
        with warnings.catch_warnings(record=True) as warned:
            found = [source.find(*pair) for pair in zip(competitions, seasons, strict=True)]
            passes = source.passes(
                found, lambda done, of: progress.update(bar, completed=done, total=of)
            )
    notes += [str(warning.message) for warning in warned]
    if source.missing:
        shown = ", ".join(map(str, source.missing[:5])) + (", ..." * (len(source.missing) > 5))
        notes.append(
            f"{len(source.missing)} matches are listed but not there yet, and left out: {shown}."
        )
    return passes
