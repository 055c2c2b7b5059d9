"""The CSV tables of a run, which grow by a row at a time."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from fbrl.files.appended_file import AppendedFile
from fbrl.files.atomic_write import atomic_write
from fbrl.run_files import FRAMES


class Table:
    """A table that grows by a row at a time.

    Args:
        path: Its file; the directory exists.
        columns: Their names; a table that is there already keeps those that it has.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._columns = _header(path) or columns
        self._file = AppendedFile(path, header=_line(self._columns))

    def append(self, row: Mapping[str, float]) -> None:
        """Adds a row, after the header where the file is new; what it lacks stays empty.

        Raises:
            OSError: The file can't be written now; the row is written with the next one.
        """
        self._file.append(_line([row.get(name, "") for name in self._columns]))


def drop_rows(path: Path, past: int) -> None:
    """Drops the rows past a number of frames, and a last one that is not whole, if there is a file.

    The others stay as they are, to the last digit.

    Raises:
        OSError: The file can't be read or written; it is then left alone.
    """
    if not path.exists():
        return
    header, kept = _header(path), []
    if header:
        place = header.index(FRAMES)
        names, *rows = path.read_bytes().splitlines(keepends=True)
        kept = [names, *(row for row in rows if _is_kept(row, len(header), place, past))]
    with atomic_write(path) as file:
        file.writelines(kept)


def _is_kept(line: bytes, num_columns: int, place: int, past: int) -> bool:
    values = _values(line)
    if len(values) != num_columns or not line.endswith(b"\n"):
        return False
    # Python reads no integers of thousands of digits.
    frames = values[place]
    return frames.isdecimal() and len(frames) < 20 and int(frames) <= past


def _header(path: Path) -> list[str]:
    """The names in the first line of a table; empty where it has none."""
    if not path.exists():
        return []
    with path.open("rb") as file:
        line = file.readline()
    names = _values(line)
    return names if line.endswith(b"\n") and FRAMES in names else []


def _line(values: Sequence[object]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text).writerow(values)
    return text.getvalue().encode()


def _values(line: bytes) -> list[str]:
    try:
        return next(csv.reader(io.StringIO(line.decode(errors="replace"))), [])
    except csv.Error:  # of a damaged line
        return []
