"""The progress of a video: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

SECONDS_BETWEEN_LINES = 15.0


class WatchDisplay:
    """Shows the steps of the match that is played, and the frames of the one that is drawn."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TextColumn("{task.fields[unit]}"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._playing = self._bar.add_task("", total=None, visible=False, unit="steps")
        self._drawing = self._bar.add_task("", total=None, visible=False, unit="frames")
        self._last_line = time.monotonic()

    def __enter__(self) -> WatchDisplay:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def playing(self, finished: int, steps: int) -> None:
        """Shows how many matches are over, and the steps of the one that is played."""
        what = f"playing match {finished + 1}"
        self._bar.update(self._playing, description=what, completed=steps, visible=True)
        self._print(f"{what}: step {steps}")

    def drawing(self, number: int, frame: int, frames: int) -> None:
        """Shows how many frames of a match are drawn."""
        what = f"drawing match {number}"
        self._bar.update(
            self._drawing, description=what, completed=frame, total=frames, visible=True
        )
        self._print(f"{what}: frame {frame}/{frames}")

    def _print(self, line: str) -> None:
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last_line > SECONDS_BETWEEN_LINES:
            self._last_line = now
            self._console.print(line)
