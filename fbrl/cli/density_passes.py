"""Which passes ``fbrl-density`` takes: its options for them, and how they are read."""

from __future__ import annotations

import argparse
import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fbrl.cli.outputs import ProgressDisplay, console
from fbrl.density.filters import DEFAULT_POPULATION, FILTERS, POPULATIONS, PassFilter, count_groups
from fbrl.density.passes import Pass, Passes, clean
from fbrl.density.statsbomb import StatsBombSource
from fbrl.density.tables import read_event_files, read_passes_csv


def add_pass_options(parser: argparse.ArgumentParser) -> None:
    """Adds where passes come from, and which of them are taken."""
    add = parser.add_argument_group("source, one of").add_argument
    add(
        "--competition",
        action="append",
        metavar="NAME",
        help="competition of StatsBomb's open data, by name or number; once for each --season",
    )
    add(
        "--season", action="append", metavar="NAME", help="its season, such as 2015/2016, or number"
    )
    add(
        "--csv",
        type=Path,
        metavar="FILE",
        help="table with x, y, end_x and end_y on the 120 x 80 pitch and, if known, competition, "
        "season, match_id, play_pattern, pass_type, cross, goal_assist",
    )
    add(
        "--events",
        type=Path,
        metavar="DIR",
        help="StatsBomb's event files: <match>.json or <match>.json.gz",
    )

    add = parser.add_argument_group("which passes").add_argument
    names = "; ".join(f"{name}: {entry.description}" for name, entry in FILTERS.items())
    add(
        "--filter",
        choices=list(FILTERS),
        help=f"{names} (default: regular-play, or all for a table without play_pattern)",
    )
    populations = "; ".join(f"{name}: {text}" for name, text in POPULATIONS.items())
    add("--passes", choices=list(POPULATIONS), default=DEFAULT_POPULATION, help=populations)
    add("--exclude-crosses", action="store_true", help="leave out crosses")
    add(
        "--min-x", type=float, metavar="X", help="least x of the start, 0 to 120 (60: halfway line)"
    )
    add("--min-end-x", type=float, metavar="X", help="least x of the end")
    add(
        "--drop-unusable",
        action="store_true",
        help="leave out passes at NaN or outside the pitch, which are an error otherwise",
    )

    add = parser.add_argument_group("download").add_argument
    add("--jobs", type=int, default=8, help="files downloaded at once")
    add("--refresh", action="store_true", help="download anew what was kept before")

    add = parser.add_argument_group("what is said of the passes").add_argument
    add("--source", help="their competitions and seasons (default: as read)")
    add("--credit", default="Data: StatsBomb", help="credit to their owner")


@dataclass(frozen=True)
class Reading:
    """The passes that are left, in all and of each season, in words, and what was left out."""

    rows: Sequence[Pass]
    counts: dict[str, int]
    description: str
    notes: Sequence[str]


def read_passes(options: argparse.Namespace) -> Reading:
    """Reads, filters and cleans the passes that the options ask for.

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
    chosen = PassFilter(
        name=options.filter,
        population=options.passes,
        exclude_crosses=options.exclude_crosses,
        min_x=options.min_x,
        min_end_x=options.min_end_x,
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
    with ProgressDisplay() as display, warnings.catch_warnings(record=True) as warned:
        found = [source.find(*pair) for pair in zip(competitions, seasons, strict=True)]
        passes = source.passes(
            found, lambda done, of: display.show("Reading matches", done, of, "matches")
        )
    notes += [str(warning.message) for warning in warned]
    if source.missing:
        shown = ", ".join(map(str, source.missing[:5])) + (", ..." * (len(source.missing) > 5))
        notes.append(
            f"{len(source.missing)} matches are listed but not there yet, and left out: {shown}."
        )
    return passes


def print_counts(reading: Reading) -> None:
    """Prints how many passes there are of each competition and season."""
    out = console()
    for note in reading.notes:
        console(stderr=True).print(f"Note: {note}")
    width = max(len(group) for group in [*reading.counts, "together"])
    for group, count in reading.counts.items():
        out.print(f"{group:{width}}  {count:>6}")
    out.print(f"{'together':{width}}  {len(reading.rows):>6}  ({reading.description})")
