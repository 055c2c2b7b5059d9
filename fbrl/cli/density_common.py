"""What the parts of ``fbrl-density`` share."""

from __future__ import annotations

import argparse

from rich.console import Console

from fbrl.cli.density_source import Reading
from fbrl.cli.outputs import console

DENSITY_PROGRAM = "fbrl-density"


def add_density(parser: argparse.ArgumentParser) -> None:
    """Adds the positional argument that names a density."""
    parser.add_argument(
        "density",
        nargs="?",
        default="default",
        metavar="DENSITY",
        help="density file, or default, uniform, mirrored or shuffled (default: %(default)s)",
    )


def print_counts(reading: Reading) -> None:
    """Prints how many passes there are of each competition and season."""
    out = console()
    for note in reading.notes:
        Console(stderr=True, highlight=False, soft_wrap=True, markup=False).print(f"Note: {note}")
    width = max(len(group) for group in [*reading.counts, "together"])
    for group, count in reading.counts.items():
        out.print(f"{group:{width}}  {count:>6}")
    out.print(f"{'together':{width}}  {len(reading.rows):>6}  ({reading.description})")
