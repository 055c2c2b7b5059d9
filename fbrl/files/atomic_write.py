"""Files that are replaced in one piece or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def atomic_write(path: Path, keep_as: Path | None = None) -> Iterator[BinaryIO]:
    """Opens a file to be written; it takes its name once it is whole and on the disk.

    At any moment, also after a crash of the machine, the old file or the new one is there whole.
    The old one goes to ``keep_as``, if that is given.

    Raises:
        OSError: It can't be written; the old file is left alone.
    """
    temporary = path.with_name(path.name + ".partial")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if keep_as is not None and path.exists():
            _keep(path, keep_as)
        temporary.replace(path)
        # Names are part of the directory, which reaches the disk on its own.
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    finally:
        temporary.unlink(missing_ok=True)


def _keep(path: Path, keep_as: Path) -> None:
    """Gives the file a second name, so that the first one is never missing."""
    link = keep_as.with_name(keep_as.name + ".partial")
    try:
        link.unlink(missing_ok=True)
        link.hardlink_to(path)
        link.replace(keep_as)
    except OSError:  # not every file system knows hard links
        path.replace(keep_as)
    finally:
        # Where both are names of one file already, replacing leaves the link.
        link.unlink(missing_ok=True)
