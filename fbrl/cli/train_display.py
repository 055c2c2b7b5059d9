"""The progress of a training: a live bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import time
from collections.abc import Iterable, Mapping
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from fbrl.config import TrainConfig
from fbrl.presets import nearest_preset

if TYPE_CHECKING:
    import torch

SECONDS_BETWEEN_LINES = 15.0


class TrainDisplay:
    """Shows frames, frames per second, goal difference and the time left.

    Args:
        console: Where to.
        config: The training that is shown.

    Attributes:
        run_dir: Its directory, once it has begun.
    """

    def __init__(self, console: Console, config: TrainConfig) -> None:
        self._console = console
        self._config = config
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TextColumn("{task.completed:,.0f}/{task.total:,.0f} {task.fields[status]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {}
        self._last_line = 0.0
        self.run_dir: Path | None = None

    def __enter__(self) -> TrainDisplay:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Takes the bar off the screen."""
        self._bar.stop()

    def started(self, run_dir: Path, device: torch.device, frames: int) -> None:
        """Says what begins or goes on, and where."""
        self.run_dir = run_dir
        config = self._config
        start = f"Going on after {frames:,} frames with the training" if frames else "Training"
        self._console.print(
            f"{start} on {config.scenario}: {config.reward} reward, preset "
            f"{nearest_preset(config)}, {config.ppo.num_envs} matches, "
            f"{config.ppo.total_frames:,} frames, seed {config.seed}, {device.type}. Ctrl-C "
            f"saves and ends.\nRun directory: {run_dir}\n"
            f"Watch it with: {tensorboard_command(run_dir)}"
        )
        self._update("training", frames, config.ppo.total_frames, "frames")

    def postponed(self) -> None:
        """Answers a signal that comes in the middle of an update."""
        self._console.print("Ending after this update; Ctrl-C again ends at once, unsaved.")

    def warning(self, line: str) -> None:
        """Says what goes wrong without ending the training."""
        self._console.print(f"Warning: {line}")

    def metrics(self, frames: int, metrics: Mapping[str, float]) -> None:
        """Shows an iteration's metrics."""
        speed = metrics["time/frames_per_second"]
        status = f"frames, {speed:,.0f} frames/s"
        if "time/collect_cores" in metrics:
            there = len(os.sched_getaffinity(0))
            status += f" ({metrics['time/collect_cores']:.1f} of {there} cores play)"
        if "match/goal_difference" in metrics:
            status += f", goal difference {metrics['match/goal_difference']:+.2f}"
        total = self._config.ppo.num_batches * self._config.ppo.frames_per_batch
        self._update("training", frames, total, status)
        if self._may_print() or frames >= total:
            left = timedelta(seconds=round((total - frames) / speed))
            self._console.print(f"{frames:,}/{total:,} {status}, {left} left")

    def evaluation(self, which: str, done: int, wanted: int) -> None:
        """Shows how many matches of an evaluation are over."""
        self._update(f"evaluating the {which} policy", min(done, wanted), wanted, "matches")
        if self._may_print():
            self._console.print(f"evaluating the {which} policy: {done}/{wanted} matches")

    def _update(self, description: str, done: int, total: int, status: str) -> None:
        if description not in self._tasks:
            self._tasks[description] = self._bar.add_task(description, total=total, status=status)
        for name, task in self._tasks.items():
            self._bar.update(task, visible=name == description)
        self._bar.update(self._tasks[description], completed=done, total=total, status=status)

    def _may_print(self) -> bool:
        now = time.monotonic()
        if self._console.is_terminal or now - self._last_line < SECONDS_BETWEEN_LINES:
            return False
        self._last_line = now
        return True


def tensorboard_command(run_dir: Path) -> str:
    """What starts TensorBoard on a run, for this machine alone."""
    return shlex.join([_program("tensorboard"), "--logdir", str(run_dir), "--host", "localhost"])


def resume_command(run_dir: Path, modules: Iterable[str] = ()) -> str:
    """What goes on with an interrupted training, whose components are in these modules."""
    imports = [word for module in modules for word in ("--import", module)]
    return shlex.join([_program("fbrl-train"), "--resume", str(run_dir), *imports])


def _program(name: str) -> str:
    # Not on the path where the command was called by its path, as `make train` does.
    program = Path(shutil.which(name) or Path(sys.executable).with_name(name))
    with contextlib.suppress(ValueError):
        program = program.relative_to(Path.cwd())
    return str(program)
