"""Values of options, checked as they are read."""

from __future__ import annotations

import argparse
import math

from fbrl.components import ConfigError, import_modules

IMPORT_HELP = "import this module, whose classes a run names; may be repeated"

LARGEST_COUNT = 10**9

DEFAULT_TOLERANCE = 0.1
"""How far below a threshold still counts as kept."""


def add_import(parser: argparse.ArgumentParser) -> None:
    """Adds ``--import``, which imports a module as soon as it is read."""
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        type=_imported,
        metavar="MODULE",
        help=IMPORT_HELP,
    )


def _imported(name: str) -> str:
    try:
        import_modules([name])
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return name


def positive_integer(text: str) -> int:
    """An integer of at least 1, of things that can be counted up to."""
    value = int(text)
    if not 1 <= value <= LARGEST_COUNT:
        raise argparse.ArgumentTypeError(f"{value} is not in [1, {LARGEST_COUNT:,}]")
    return value


def seed(text: str) -> int:
    """An integer that the engine takes as a seed."""
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{value} is not in [0, 2**32 - 1]")
    return value


def finite_number(text: str) -> float:
    """A number that is neither infinite nor NaN."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def number_from_zero(text: str) -> float:
    """A finite number of at least 0."""
    value = finite_number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is not at least 0")
    return value


# argparse puts these names into what it says of a text that is no number at all.
positive_integer.__name__ = "integer"
seed.__name__ = "seed"
finite_number.__name__ = number_from_zero.__name__ = "number"
