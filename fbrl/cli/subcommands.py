"""Commands with subcommands: their parsers, and how the chosen one is run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from fbrl.cli.errors import Parser, ending_on_bad_input, ending_when_interrupted


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], None] | None,
    summary: str,
    description: str | None = None,
) -> Parser:
    """Adds a subcommand that calls ``run``."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=description or f"{summary[0].upper()}{summary[1:]}.",
    )
    parser.set_defaults(command=run, program=parser.prog)
    return parser


def run_command(options: argparse.Namespace, remark: str) -> NoReturn:
    """Runs the subcommand of parsed options and ends the process.

    Args:
        options: What a parser with subcommands returned.
        remark: What is said of an interruption.
    """
    with ending_when_interrupted(options.program, remark), ending_on_bad_input(options.program):
        options.command(options)
    sys.exit(0)
