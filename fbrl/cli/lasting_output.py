"""Output that ends no work: what can't be written is lost, the files of the command are not."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import IO, Any, cast


class LastingStream:
    """A stream whose text is lost, without an error, where it can't be written.

    Letters that its encoding lacks are written as escapes.

    Args:
        stream: Where to.

    Attributes:
        error: The first one that there was.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Writes what can be written; returns the text's length."""
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        with self._noting_errors():
            self._stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def flush(self) -> None:
        """Writes what waits."""
        with self._noting_errors():
            self._stream.flush()

    def finish(self) -> None:
        """Writes what waits, and lets go of what can't be written."""
        self.flush()
        if self.error is not None:
            # Python would try again at the end of the process, and complain. Not every stream has
            # a descriptor: a notebook's hasn't.
            with open(os.devnull, "w") as nowhere, contextlib.suppress(OSError):
                os.dup2(nowhere.fileno(), self._stream.fileno())

    @contextlib.contextmanager
    def _noting_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = self.error or error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """Has standard output and standard error lost where they can't be written.

    Yields:
        Standard output.
    """
    streams = sys.stdout, sys.stderr
    # There is none in a process that was started with it closed. What takes its number is then
    # nothing that the engine could write to.
    output, errors = (LastingStream(one or open(os.devnull, "w")) for one in streams)  # noqa: SIM115
    sys.stdout, sys.stderr = cast("IO[str]", output), cast("IO[str]", errors)
    try:
        yield output
    finally:
        sys.stdout, sys.stderr = streams
        output.finish()
        errors.finish()


@contextlib.contextmanager
def lasting_output() -> Iterator[IO[str]]:
    """Standard output for work that is worth more than its messages."""
    with lasting_streams() as output:
        yield cast("IO[str]", output)
