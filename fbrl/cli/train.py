"""``fbrl-train SCENARIO``: trains an agent; with ``--resume RUN_DIR`` it goes on."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

# Threads that wait for work by spinning would take the cores from the matches; OpenMP reads this
# when PyTorch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from rich.console import Console

from fbrl.allocator import preload_tcmalloc
from fbrl.checks import UnknownNameError
from fbrl.cli.errors import FAILED, INTERRUPTED, ending_when_interrupted, fail
from fbrl.cli.outputs import ProgressDisplay, console
from fbrl.cli.train_options import parse_resume, parse_training
from fbrl.config import ConfigError, TrainConfig
from fbrl.presets import nearest_preset
from fbrl.run_files import CHECKPOINT_NAME

if TYPE_CHECKING:
    import torch

    from fbrl.training import TrainResult

PROGRAM = "fbrl-train"


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command.

    Ends the process with 0; 2 on bad usage; 1 if the training diverged, could not be saved or
    hung; 130 if it was interrupted.
    """
    with ending_when_interrupted(PROGRAM, "interrupted; nothing was saved since the last line"):
        arguments = sys.argv[1:] if arguments is None else arguments
        resume = any(argument.split("=")[0] == "--resume" for argument in arguments)
        config = (parse_resume if resume else parse_training)(PROGRAM, arguments)
        preload_tcmalloc(PROGRAM)
        result = _train(config, resume)
        if result.interrupted:
            line = f"{PROGRAM}: saved and ended with exit code {INTERRUPTED}."
            print(line, _going_on(result.run_dir, config), file=sys.stderr)
        # Whether all that was printed could be read is not asked: the training is what counts.
        sys.exit(INTERRUPTED if result.interrupted else 0)


def _train(config: TrainConfig, resume: bool) -> TrainResult:
    # Seconds of imports, which --help and a mistyped option needn't wait for.
    from fbrl.checkpoint import CheckpointError
    from fbrl.collect.collector import MatchWorkersError
    from fbrl.envs import EngineNotInstalledError, ScenarioError
    from fbrl.ppo.update import TrainingDivergedError
    from fbrl.training import TrainListener, train
    from fbrl.training.run_checkpoints import TrainingNotSavedError
    from fbrl.training.run_dir import RunDirReplacedError

    display = TrainDisplay(console(), config)
    listener = TrainListener(
        on_start=display.started,
        on_metrics=display.metrics,
        on_evaluation=display.evaluation,
        on_postponed=display.postponed,
        on_warning=display.warning,
        on_hang=display.hang,
    )
    try:
        with display:
            result = train(config, listener, resume=resume)
    except (
        CheckpointError,
        ConfigError,
        EngineNotInstalledError,
        OSError,
        ScenarioError,
        UnknownNameError,
    ) as error:
        fail(PROGRAM, error)
    except (TrainingNotSavedError, MatchWorkersError) as error:
        fail(PROGRAM, f"{error} {_going_on(display.run_dir, config)}", exit_code=FAILED)
    except (TrainingDivergedError, RunDirReplacedError) as error:
        fail(PROGRAM, error, exit_code=FAILED)
    display.ended(result)
    return result


class TrainDisplay(ProgressDisplay):
    """Shows frames, frames per second, goal difference and the time left of a training.

    ``run_dir`` is its directory, once it has begun.
    """

    def __init__(self, screen: Console, config: TrainConfig) -> None:
        super().__init__(screen)
        self._config = config
        self.run_dir: Path | None = None

    def started(self, run_dir: Path, device: torch.device, frames: int) -> None:
        """Says what begins or goes on, and where."""
        self.run_dir = run_dir
        config = self._config
        start = f"Going on after {frames:,} frames with the training" if frames else "Training"
        self.screen.print(
            f"{start} on {config.scenario}: {config.reward} reward, preset "
            f"{nearest_preset(config)}, {config.ppo.num_envs} matches, "
            f"{config.ppo.total_frames:,} frames, seed {config.seed}, {device.type}. Ctrl-C "
            f"saves and ends.\nRun directory: {run_dir}\n"
            f"Watch it with: {tensorboard_command(run_dir)}"
        )
        self.show("training", frames, config.ppo.total_frames, "frames")
        self._last_line = -math.inf  # the first iteration's line comes at once

    def postponed(self) -> None:
        """Answers a signal that comes in the middle of an update."""
        self.screen.print("Ending after this update; Ctrl-C again ends at once, unsaved.")

    def warning(self, line: str) -> None:
        """Says what goes wrong without ending the training."""
        self.screen.print(f"Warning: {line}")

    def metrics(self, frames: int, metrics: Mapping[str, float]) -> None:
        """Shows an iteration's metrics."""
        speed = metrics["time/frames_per_second"]
        status = f"frames, {speed:,.0f} frames/s"
        if "time/collect_cores" in metrics:
            there = len(os.sched_getaffinity(0))
            status += f" ({metrics['time/collect_cores']:.1f} of {there} cores play)"
        if "match/goal_difference" in metrics:
            status += f", goal difference {metrics['match/goal_difference']:+.2f}"
        total = self._config.ppo.frames_of_batches
        left = f", {timedelta(seconds=round((total - frames) / speed))} left"
        is_last = frames >= total
        self.show("training", frames, total, status, end_of_line=left, always=is_last)

    def evaluation(self, which: str, done: int, wanted: int) -> None:
        """Shows how many matches of an evaluation are over."""
        self.show(f"evaluating the {which} policy", min(done, wanted), wanted, "matches")

    def hang(self, line: str) -> None:
        """Says, just before the process is ended, that it hangs and what goes on."""
        self.stop()
        going_on = _going_on(self.run_dir, self._config)
        print(f"{PROGRAM}: error: {line} {going_on}", file=sys.stderr, flush=True)

    def ended(self, result: TrainResult) -> None:
        """Prints what came out of the training, where it is and how to look at it."""
        for name, evaluation in (("untrained", result.untrained), ("trained", result.trained)):
            if evaluation is not None:
                self.screen.print(f"Goal difference, {name}: {evaluation} (mean, 95 % interval)")
        ended = "Interrupted" if result.interrupted else "Done"
        where = shlex.quote(str(result.run_dir))
        self.screen.print(
            f"{ended} after {result.frames:,} frames. Everything is in {where}; look at it with: "
            f"{tensorboard_command(result.run_dir)}"
        )


def _going_on(run_dir: Path | None, config: TrainConfig) -> str:
    """The sentence that says how to go on with a training, if there is anything to go on from."""
    if run_dir is None or not (run_dir / CHECKPOINT_NAME).exists():
        return ""
    imports = [word for module in config.modules for word in ("--import", module)]
    return f"Go on with: {shlex.join([_program(PROGRAM), '--resume', str(run_dir), *imports])}"


def tensorboard_command(run_dir: Path) -> str:
    """What starts TensorBoard on a run, for this machine alone."""
    return shlex.join([_program("tensorboard"), "--logdir", str(run_dir), "--host", "localhost"])


def _program(name: str) -> str:
    # Not on the path where the command was called by its path, as `make train` does.
    program = Path(shutil.which(name) or Path(sys.executable).with_name(name))
    with contextlib.suppress(ValueError):
        program = program.relative_to(Path.cwd())
    return str(program)
