"""What commands print and write: checked before long work, figures saved after it."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def add_figure_option(parser: argparse.ArgumentParser) -> None:
    """Adds ``--out``, the files of a figure."""
    parser.add_argument(
        "--out", type=Path, nargs="+", required=True, help="figures to write: .png, .svg or both"
    )


def check_figure_outputs(options: argparse.Namespace, *others: Path) -> None:
    """Refuses figures, and other files beside them, that could not be written."""
    from fbrl.figures.files import check_figure_path

    check_outputs(*map(check_figure_path, options.out), *others)


def write_figure(options: argparse.Namespace, figure: Figure) -> None:
    """Writes a figure and says where it is."""
    from fbrl.figures.files import save_figure

    save_figure(figure, *options.out)
    for path in options.out:
        console().print(f"Written to {path}")
