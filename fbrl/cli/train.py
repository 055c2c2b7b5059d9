"""``fbrl-train SCENARIO``: trains an agent; with ``--resume RUN_DIR`` it goes on."""

from __future__ import annotations

import argparse
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
from fbrl.cli.errors import INTERRUPTED, ending_when_interrupted, fail, parsing
from fbrl.cli.lasting_output import lasting_output
from fbrl.cli.train_display import TrainDisplay, resume_command, tensorboard_command
from fbrl.cli.train_options import parse_options
from fbrl.cli.train_resume import asks_to_resume, parse_resume
from fbrl.config import PRESET_NAMES, ConfigError, TrainConfig
from fbrl.presets import preset_config
from fbrl.run_files import CHECKPOINT_NAME

if TYPE_CHECKING:
    from fbrl.training import TrainResult

PROGRAM = "fbrl-train"

DESCRIPTION = """Train a football agent with PPO on a scenario of Google Research Football.

The defaults shown are those of the preset light; add --preset thesis to see that one's. Every
option can be set on top of a preset. Examples:
  fbrl-train academy_3_vs_1_with_keeper
  fbrl-train academy_counterattack_hard --preset thesis --device cuda
  fbrl-train 11_vs_11_easy_stochastic --reward scoring --total-frames 2000000 --num-envs 16

A training that was interrupted, or that died, goes on as if it had never stopped with
  fbrl-train --resume RUN_DIR

Of its options only a few can then be changed, see fbrl-train --resume RUN_DIR --help.

Where tcmalloc is installed, it takes the place of the C library's allocator, which makes matches
faster; FBRL_TCMALLOC=0 in the environment prevents that.
"""

FAILED = 1
"""Exit code of a training that diverged, can't be saved or hangs."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command.

    Ends the process with 0; 2 on bad usage; 1 if the training diverged, could not be saved or
    hung; 130 if it was interrupted.
    """
    with ending_when_interrupted(PROGRAM, "interrupted; nothing was saved since the last line"):
        arguments = sys.argv[1:] if arguments is None else arguments
        resume = asks_to_resume(arguments)
        config = parse_resume(PROGRAM, arguments) if resume else parse(arguments)
        preload_tcmalloc(PROGRAM)
        _main(config, resume)


def _main(config: TrainConfig, resume: bool) -> None:
    # Seconds of imports, which --help and a mistyped option needn't wait for.
    from fbrl.checkpoint import CheckpointError
    from fbrl.collect.collector import MatchWorkersError
    from fbrl.envs import EngineNotInstalledError
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
            lambda line: report_hang(display, line),
        )
        try:
            with display:
                result = train(config, listener, resume=resume)
        except (
            CheckpointError,
            ConfigError,
            UnknownNameError,
            EngineNotInstalledError,
            OSError,
        ) as error:
            fail(PROGRAM, error)
        except (TrainingNotSavedError, MatchWorkersError) as error:
            fail(PROGRAM, f"{error} {going_on(display.run_dir)}", exit_code=FAILED)
        except (TrainingDivergedError, RunDirReplacedError) as error:
            fail(PROGRAM, error, exit_code=FAILED)
        report(console, result)
    if result.interrupted:
        line = f"{PROGRAM}: saved and ended with exit code {INTERRUPTED}."
        print(line, going_on(result.run_dir), file=sys.stderr)
    sys.exit(INTERRUPTED if result.interrupted else 0)


def parse(arguments: Sequence[str]) -> TrainConfig:
    """The configuration of a command line: a preset, and what is changed on top of it."""
    preset_parser = argparse.ArgumentParser(
        prog=PROGRAM, add_help=False, allow_abbrev=False, exit_on_error=False
    )
    preset_parser.add_argument("--preset", default=PRESET_NAMES[0])
    try:
        preset = preset_parser.parse_known_args(list(arguments))[0].preset
        # The scenario decides between the rows of the thesis's table, so it is read first.
        scenario = _parse(arguments, preset_config(preset, "")).scenario
        config = _parse(arguments, preset_config(preset, scenario))
        config.check()
    except (ConfigError, UnknownNameError, argparse.ArgumentError) as error:
        fail(PROGRAM, error)
    return config


def _parse(arguments: Sequence[str], defaults: TrainConfig) -> TrainConfig:
    with parsing(PROGRAM):
        return parse_options(PROGRAM, DESCRIPTION, arguments, defaults)


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


def report_hang(display: TrainDisplay, line: str) -> None:
    """Says, just before the process is ended, that it hangs and what goes on with the training."""
    display.stop()
    print(f"{PROGRAM}: error: {line} {going_on(display.run_dir)}", file=sys.stderr, flush=True)


def going_on(run_dir: Path | None) -> str:
    """The sentence that says how to go on with a training, if there is anything to go on from."""
    if run_dir is None or not (run_dir / CHECKPOINT_NAME).exists():
        return ""
    return f"Go on with: {resume_command(run_dir)}"
