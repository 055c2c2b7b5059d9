"""The options of ``fbrl-density`` that say which passes, and how densities are fitted to them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from fbrl.density.filters import DEFAULT_POPULATION, FILTERS, POPULATIONS, PassFilter
from fbrl.density.fit import COARSEST_GRID, FINEST_GRID, PEAK_END, PEAK_START
from fbrl.density.kde import BandwidthRule


def add_pass_options(parser: argparse.ArgumentParser) -> None:
    """Adds where passes come from, and which of them are taken."""
    source = parser.add_argument_group("source, one of")
    source.add_argument(
        "--competition",
        action="append",
        metavar="NAME",
        help="competition of StatsBomb's open data, by name or number; once for each --season",
    )
    source.add_argument(
        "--season", action="append", metavar="NAME", help="its season, such as 2015/2016, or number"
    )
    source.add_argument(
        "--csv",
        type=Path,
        metavar="FILE",
        help="table with x, y, end_x and end_y on the 120 x 80 pitch and, if known, competition, "
        "season, match_id, play_pattern, pass_type, cross, goal_assist",
    )
    source.add_argument(
        "--events",
        type=Path,
        metavar="DIR",
        help="StatsBomb's event files: <match>.json or <match>.json.gz",
    )

    chosen = parser.add_argument_group("which passes")
    names = "; ".join(f"{name}: {entry.description}" for name, entry in FILTERS.items())
    chosen.add_argument(
        "--filter",
        choices=list(FILTERS),
        help=f"{names} (default: regular-play, or all for a table without play_pattern)",
    )
    populations = "; ".join(f"{name}: {text}" for name, text in POPULATIONS.items())
    chosen.add_argument(
        "--passes",
        choices=list(POPULATIONS),
        default=DEFAULT_POPULATION,
        help=f"{populations} (default: %(default)s)",
    )
    chosen.add_argument("--exclude-crosses", action="store_true", help="leave out crosses")
    chosen.add_argument(
        "--min-x", type=float, metavar="X", help="least x of the start, 0 to 120 (60: halfway line)"
    )
    chosen.add_argument("--min-end-x", type=float, metavar="X", help="least x of the end")
    chosen.add_argument(
        "--drop-unusable",
        action="store_true",
        help="leave out passes at NaN or outside the pitch, which are an error otherwise",
    )

    download = parser.add_argument_group("download")
    download.add_argument(
        "--jobs", type=int, default=8, help="files downloaded at once (default: %(default)s)"
    )
    download.add_argument(
        "--refresh", action="store_true", help="download anew what was kept before"
    )

    said = parser.add_argument_group("what is said of the passes")
    said.add_argument("--source", help="their competitions and seasons (default: as read)")
    said.add_argument(
        "--credit", default="Data: StatsBomb", help="credit to their owner (default: %(default)s)"
    )


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Adds how densities are fitted."""
    fit = parser.add_argument_group("density")
    fit.add_argument(
        "--bandwidth",
        type=_bandwidth,
        default="thesis",
        metavar="RULE",
        help=f"{', '.join(get_args(BandwidthRule))}, or a number (default: %(default)s)",
    )
    fit.add_argument(
        "--metres",
        action="store_true",
        help="kernels round in metres, and a number in metres, not in pitch units "
        "(one is 54.4 m along x, 83.6 m along y)",
    )
    fit.add_argument(
        "--grid",
        type=int,
        metavar="COLUMNS",
        help=f"grid nodes along x, {COARSEST_GRID} to {FINEST_GRID} (default: enough for an error "
        "of at most 0.5 %% of the peak)",
    )
    fit.add_argument(
        "--peak-start", type=float, default=PEAK_START, help="highest start density (%(default)s)"
    )
    fit.add_argument(
        "--peak-end", type=float, default=PEAK_END, help="highest end density (%(default)s)"
    )
    fit.add_argument(
        "--mirror", action="store_true", help="average with the left-right mirror image"
    )


def pass_filter(options: argparse.Namespace) -> PassFilter:
    """The filter that the options describe."""
    return PassFilter(
        name=options.filter,
        population=options.passes,
        exclude_crosses=options.exclude_crosses,
        min_x=options.min_x,
        min_end_x=options.min_end_x,
    )


def _bandwidth(text: str) -> BandwidthRule | float:
    if text in get_args(BandwidthRule):
        return text  # type: ignore[return-value]  # one of its names
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(get_args(BandwidthRule))}, and no number"
        ) from None
