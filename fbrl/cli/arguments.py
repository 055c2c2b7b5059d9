"""Values of options, checked as they are read."""

from __future__ import annotations

import argparse
from sys import float_info
from typing import Any

from fbrl.registry import ConfigError, import_modules

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


def number_in(kind: type, low: float, high: float, allowed: str, name: str = "") -> Any:
    """A function that reads a number of a range, for argparse's ``type``.

    Args:
        kind: ``int`` or ``float``.
        low: The least.
        high: The greatest.
        allowed: The range in words, as in "-1 is not in [0, 5]".
        name: What it calls a text that is no number at all; "integer" or "number" by default.
    """

    def read(text: str) -> Any:
        value = kind(text)
        if not low <= value <= high:  # as NaN isn't
            raise argparse.ArgumentTypeError(f"{text} is not {allowed}")
        return value

    read.__name__ = name or {int: "integer", float: "number"}[kind]
    return read


positive_integer = number_in(int, 1, LARGEST_COUNT, f"in [1, {LARGEST_COUNT:,}]")
seed = number_in(int, 0, 2**32 - 1, "in [0, 2**32 - 1]", "seed")
finite_number = number_in(float, -float_info.max, float_info.max, "a finite number")
number_from_zero = number_in(float, 0, float_info.max, "a finite number of at least 0")
