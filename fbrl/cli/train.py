"""``fbrl-train SCENARIO``: trains an agent; with ``--resume RUN_DIR`` it goes on."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# Threads that wait for work by spinning would take the cores from the matches; OpenMP reads this
# when PyTorch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from rich.console import Console

from fbrl.allocator import preload_tcmalloc
from fbrl.checks.names import UnknownNameError
from fbrl.cli.errors import FAILED, INTERRUPTED, ending_when_interrupted, fail
from fbrl.cli.lasting_output import lasting_output
from fbrl.cli.train_display import TrainDisplay, resume_command, tensorboard_command
from fbrl.cli.train_options import parse_resume, parse_training
from fbrl.config import ConfigError, TrainConfig
from fbrl.run_files import CHECKPOINT_NAME

if TYPE_CHECKING:
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
        _main(config, resume)


def _main(config: TrainConfig, resume: bool) -> None:
    # Seconds of imports, which --help and a mistyped option needn't wait for.
    from fbrl.checkpoint import CheckpointError
    from fbrl.collect.collector import MatchWorkersError
    from fbrl.envs import EngineNotInstalledError, ScenarioError
    from fbrl.ppo.update import TrainingDivergedError
    from fbrl.training import TrainListener, train
    from fbrl.training.run_checkpoints import TrainingNotSavedError
    from fbrl.training.run_dir import RunDirReplacedError

    with lasting_output() as output:
        # A run's directory may have brackets in its name, which are no markup.
        console = Console(file=output, highlight=False, soft_wrap=True, markup=False, emoji=False)
        display = TrainDisplay(console, config)
        listener = TrainListener(
            display.started,
            display.metrics,
            display.evaluation,
            display.postponed,
            display.warning,
            lambda line: report_hang(display, line, config),
        )
        try:
            with display:
                result = train(config, listener, resume=resume)
        except (
            CheckpointError,
            ConfigError,
            UnknownNameError,
            EngineNotInstalledError,
            ScenarioError,
            OSError,
        ) as error:
            fail(PROGRAM, error)
        except (TrainingNotSavedError, MatchWorkersError) as error:
            fail(PROGRAM, f"{error} {going_on(display.run_dir, config)}", exit_code=FAILED)
        except (TrainingDivergedError, RunDirReplacedError) as error:
            fail(PROGRAM, error, exit_code=FAILED)
        report(console, result)
    if result.interrupted:
        line = f"{PROGRAM}: saved and ended with exit code {INTERRUPTED}."
        print(line, going_on(result.run_dir, config), file=sys.stderr)
    sys.exit(INTERRUPTED if result.interrupted else 0)


def report(console: Console, result: TrainResult) -> None:
    """Prints what came out of a training, where it is and how to look at it."""
    for name, evaluation in (("untrained", result.untrained), ("trained", result.trained)):
        if evaluation is not None:
            console.print(f"Goal difference, {name}: {evaluation} (mean, 95 % interval)")
    ended = "Interrupted" if result.interrupted else "Done"
    where = shlex.quote(str(result.run_dir))
    console.print(
        f"{ended} after {result.frames:,} frames. Everything is in {where}; look at it with: "
        f"{tensorboard_command(result.run_dir)}"
    )


def report_hang(display: TrainDisplay, line: str, config: TrainConfig) -> None:
    """Says, just before the process is ended, that it hangs and what goes on with the training."""
    display.stop()
    print(
        f"{PROGRAM}: error: {line} {going_on(display.run_dir, config)}", file=sys.stderr, flush=True
    )


def going_on(run_dir: Path | None, config: TrainConfig) -> str:
    """The sentence that says how to go on with a training, if there is anything to go on from."""
    if run_dir is None or not (run_dir / CHECKPOINT_NAME).exists():
        return ""
    return f"Go on with: {resume_command(run_dir, config.modules)}"
