"""Standard output that ends no long work: a full disk or a closed terminal only silences it."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import IO, Any, cast


class _LastingStream:
    """A stream whose lines are lost, without an error, where they can't be written."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def lasting_output() -> Iterator[IO[str]]:
    """Standard output for work that is worth more than its messages."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        # There is none in a process that was started with it closed.
        output = sys.stdout or nowhere
        try:
            yield cast("IO[str]", _LastingStream(output))
        finally:
            try:
                output.flush()
            except OSError:
                # Python would try again at the end of the process, and complain.
                os.dup2(nowhere.fileno(), output.fileno())
