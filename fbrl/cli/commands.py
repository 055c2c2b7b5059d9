"""What commands with subcommands share: their parsers, printing, checks before long work."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from fbrl.cli.errors import Parser


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
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(command=run, program=parser.prog)
    return parser


def console() -> Console:
    """Standard output, where names and paths are printed as they are."""
    return Console(highlight=False, soft_wrap=True, markup=False)


def check_outputs(*paths: Path) -> None:
    """Refuses, before minutes of work, paths that cannot be written to after it.

    Raises:
        ValueError: if a path is a directory, or its directory is missing.
    """
    for path in paths:
        if path.is_dir():
            raise ValueError(f"{path} is a directory; give the name of a file.")
        if not path.parent.is_dir():
            raise ValueError(f"There is no directory {path.parent} to write {path.name} into.")
