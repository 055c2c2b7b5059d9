"""What commands print and write: plain lines, progress, files that are checked before long work."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Display = TypeVar("Display", bound="ProgressDisplay")


def console(*, stderr: bool = False) -> Console:
    """Standard output, or error, where names and paths are printed as they are."""
    return Console(stderr=stderr, highlight=False, soft_wrap=True, markup=False, emoji=False)


class ProgressDisplay:
    """A bar on a terminal for what is done at the moment, a line now and then elsewhere.

    It is on standard error unless another screen is given.
    """

    def __init__(
        self, screen: Console | None = None, *, seconds_between_lines: float = 15.0
    ) -> None:
        self.screen = screen or console(stderr=True)
        self._seconds_between_lines = seconds_between_lines
        self._last_line = time.monotonic()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            TextColumn("{task.fields[status]}", markup=False),
            TimeRemainingColumn(),
            console=self.screen,
            transient=True,
            disable=not self.screen.is_terminal,
        )
        # Each with how much of it was done.
        self._tasks: dict[str, tuple[TaskID, int]] = {}
        self._shown: TaskID | None = None

    def __enter__(self: Display) -> Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Takes the bar off the screen."""
        self._bar.stop()

    def show(
        self,
        what: str,
        done: int,
        total: int | None,
        status: str,
        *,
        end_of_line: str = "",
        always: bool = False,
    ) -> None:
        """Shows how far something is, in the place of what was shown before.

        Args:
            what: What is done; the time left is estimated for each.
            done: How much of it.
            total: Of how much; ``None`` if nobody knows.
            status: The unit, and whatever else there is to say.
            end_of_line: What a line says and a bar doesn't.
            always: Print the line in any case.
        """
        counted = f"{done:,} {status}" if total is None else f"{done:,}/{total:,} {status}"
        task, done_before = self._tasks.get(what, (None, 0))
        if task is None or done < done_before:
            # Begun again, as the next evaluation is: its time is its own.
            task = self._bar.add_task(what, total=total, status="")
        self._tasks[what] = task, done
        if self._shown is not None and self._shown != task:
            self._bar.update(self._shown, visible=False)
        self._shown = task
        self._bar.update(task, completed=done, total=total, status=counted, visible=True)
        seconds = time.monotonic() - self._last_line
        if always or (not self.screen.is_terminal and seconds >= self._seconds_between_lines):
            self._last_line = time.monotonic()
            self.screen.print(f"{what}: {counted}{end_of_line}")


def check_outputs(*paths: Path | None) -> None:
    """Refuses, before minutes of work, paths that cannot be written to after it; skips ``None``.

    Raises:
        ValueError: if a path is a directory or a device, comes twice, or its directory is missing
            or can't be written to.
    """
    seen = set()
    for path in filter(None, paths):
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


def check_figure_outputs(options: argparse.Namespace, *others: Path | None) -> None:
    """Refuses figures, and other files beside them, that could not be written."""
    from fbrl.figures.files import check_figure_path

    check_outputs(*map(check_figure_path, options.out), *others)


def write_figure(options: argparse.Namespace, figure: Figure) -> None:
    """Writes a figure and says where it is."""
    from fbrl.figures.files import save_figure

    save_figure(figure, *options.out)
    for path in options.out:
        console().print(f"Written to {path}")
