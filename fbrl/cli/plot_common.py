"""What the parts of ``fbrl-plot`` share: the threshold, and reading runs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fbrl.cli.arguments import DEFAULT_TOLERANCE, finite_number, number_from_zero
from fbrl.cli.errors import Parser

if TYPE_CHECKING:
    from fbrl.analysis.run_log import RunLog


def add_threshold(parser: Parser, meaning: str) -> None:
    """Adds ``--threshold`` and ``--tolerance``."""
    parser.add_argument("--threshold", type=finite_number, metavar="VALUE", help=meaning)
    parser.add_argument(
        "--tolerance",
        type=number_from_zero,
        metavar="VALUE",
        help="how far below the threshold still counts as kept, as the mean of 100 matches is "
        f"noisy (default: {DEFAULT_TOLERANCE}, as in fbrl-eval)",
    )


def check_tolerance(options: argparse.Namespace) -> None:
    """Fills in ``--tolerance``, and refuses it without ``--threshold``."""
    if options.threshold is None and options.tolerance is not None:
        raise ValueError("--tolerance is how far below --threshold counts as kept: give both.")
    if options.tolerance is None:
        options.tolerance = DEFAULT_TOLERANCE


def read_runs(paths: Sequence[Path]) -> list[RunLog]:
    """The logs of runs."""
    from fbrl.analysis.run_log import read_run_log

    return [read_run_log(path) for path in paths]


def count(number: int, thing: str) -> str:
    """Such as "1 seed" or "2 seeds"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
