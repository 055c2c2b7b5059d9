"""The progress of a video: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

from fbrl.cli.progress import ProgressDisplay

SECONDS_BETWEEN_LINES = 15.0


class WatchDisplay(ProgressDisplay):
    """Shows the steps of the match that is played, and the frames of the one that is drawn."""

    def __init__(self) -> None:
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TextColumn("{task.fields[unit]}"),
            seconds_between_lines=SECONDS_BETWEEN_LINES,
        )
        self._playing = self.bars.add_task("", total=None, visible=False, unit="steps")
        self._drawing = self.bars.add_task("", total=None, visible=False, unit="frames")

    def playing(self, finished: int, steps: int) -> None:
        """Shows how many matches are over, and the steps of the one that is played."""
        what = f"playing match {finished + 1}"
        self.bars.update(self._playing, description=what, completed=steps, visible=True)
        self.line(f"{what}: step {steps}")

    def drawing(self, number: int, frame: int, frames: int) -> None:
        """Shows how many frames of a match are drawn."""
        what = f"drawing match {number}"
        self.bars.update(
            self._drawing, description=what, completed=frame, total=frames, visible=True
        )
        self.line(f"{what}: frame {frame}/{frames}")
