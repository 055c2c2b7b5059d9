"""Figures as files."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from fbrl.files.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg")
_DOTS_PER_INCH = 160


def check_figure_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a picture can be of the kind that it names.

    Raises:
        ValueError: if it doesn't end in .png or .svg.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"{path}: a picture's name must end in {' or '.join(FORMATS)}.")
    return path


def save_figure(figure: Figure, *paths: str | os.PathLike[str]) -> None:
    """Writes a picture, as PNG or SVG by the name's ending; all files whole or none.

    Raises:
        ValueError: if a name has another ending.
        OSError: if a file cannot be written.
    """
    import matplotlib

    with contextlib.ExitStack() as files:
        # The same picture is the same file, whenever it is made.
        files.enter_context(matplotlib.rc_context({"svg.hashsalt": "fbrl", "svg.fonttype": "none"}))
        for path in map(check_figure_path, paths):
            kind = path.suffix.lower()[1:]
            figure.savefig(
                files.enter_context(atomic_write(path)),
                format=kind,
                dpi=_DOTS_PER_INCH,
                bbox_inches="tight",
                metadata={"Date": None} if kind == "svg" else None,
            )
