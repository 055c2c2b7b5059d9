"""Files that grow piece by piece, also where a disk is full for a while."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import BinaryIO

MOST_WAITING_BYTES = 16 * 2**20
"""What is kept in memory while a file can't be written; the oldest pieces are then lost."""


class AppendedFile:
    r"""A file to which pieces are added, each of them whole or not at all.

    A piece that can't be written waits, and is written before the next one, so that the file has
    no gap once the disk has room again. It is opened anew each time: nothing is left to be flushed
    at the end, and a file that was deleted is begun again, with the header.

    Examples:
        >>> import tempfile
        >>> table = AppendedFile(Path(tempfile.mkdtemp()) / "table.csv", header=b"frames\n")
        >>> table.append(b"64\n")
        >>> table.path.read_bytes()
        b'frames\n64\n'
    """

    def __init__(self, path: Path, header: bytes) -> None:
        self.path = path
        self._header = header
        self._waiting: deque[bytes] = deque()

    def append(self, piece: bytes) -> None:
        """Adds a piece, after those that wait.

        Raises:
            OSError: The file can't be written; the piece waits.
        """
        self._waiting.append(piece)
        while sum(map(len, self._waiting)) > MOST_WAITING_BYTES and len(self._waiting) > 1:
            self._waiting.popleft()
        with self.path.open("ab", buffering=0) as file:
            while self._waiting:
                header = b"" if file.tell() else self._header
                _write_whole(file, header + self._waiting[0])
                self._waiting.popleft()


def _write_whole(file: BinaryIO, data: bytes) -> None:
    size = file.tell()
    left = memoryview(data)
    try:
        while left:
            # On a disk that becomes full a part is written first, and only the rest fails.
            left = left[file.write(left) :]
    except OSError:
        file.truncate(size)
        raise
