"""The progress of work that takes minutes, on standard error."""

from __future__ import annotations

import time
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, ProgressColumn

Display = TypeVar("Display", bound="ProgressDisplay")


class ProgressDisplay:
    """Bars on a terminal, a line now and then elsewhere.

    Args:
        columns: What a bar shows.
        seconds_between_lines: How often a line is printed where there is no terminal.
    """

    def __init__(self, *columns: ProgressColumn, seconds_between_lines: float) -> None:
        self._console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
        self._seconds_between_lines = seconds_between_lines
        self._last_line = time.monotonic()
        self.bars = Progress(
            *columns,
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )

    def __enter__(self: Display) -> Display:
        self.bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bars.stop()

    def line(self, text: str) -> None:
        """Prints a line where there is no terminal, unless there was one a moment ago."""
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last_line > self._seconds_between_lines:
            self._last_line = now
            self._console.print(text)
