"""What commands with subcommands share: their parsers, printing, checks before long work."""

from __future__ import annotations

import argparse
import tempfile
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
    )
    parser.set_defaults(command=run, program=parser.prog)
    return parser


def console() -> Console:
    """Standard output, where names and paths are printed as they are."""
    return Console(highlight=False, soft_wrap=True, markup=False)


def check_outputs(*paths: Path) -> None:
    """Refuses, before minutes of work, paths that cannot be written to after it.

    Raises:
        ValueError: if a path is a directory or a device, comes twice, or its directory is missing
            or can't be written to.
    """
    seen = set()
    for path in paths:
        if path.is_dir():
            raise ValueError(f"{path} is a directory; give the name of a file.")
        if path.exists() and not path.is_file():
            raise ValueError(f"{path} is a device or a pipe; give the name of a file.")
        if not path.parent.is_dir():
            raise ValueError(f"There is no directory {path.parent} to write {path.name} into.")
        if path.resolve() in seen:
            raise ValueError(f"Two things would be written to {path}: give each a file of its own.")
        seen.add(path.resolve())
        try:
            # The permissions alone don't say it: a file system may be read-only, or hold no files.
            tempfile.TemporaryFile(dir=path.parent).close()
        except OSError as error:
            raise ValueError(
                f"{path} can't be written: no file can be made in {path.parent} ({error.strerror})."
            ) from error
