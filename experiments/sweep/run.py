"""Trains an agent for each point of a grid, on a Ray cluster or on this machine alone.

    python experiments/sweep/run.py experiments/sweep/grid.yaml runs/sweep --cpus-per-run 4

The grid is a YAML file of options of fbrl-train: a list is gone through, and each combination of
the lists is one training with a directory of its own below the second argument. The same command
again skips what is finished and goes on with what is not, so it is also what one does after an
interruption. Ctrl-C, SIGTERM and SIGUSR1 let every training save and end.

The cluster is that of RAY_ADDRESS, or the one that `ray start` has started on this machine; without
either all is done on this machine. The directory has to be on a file system that all nodes share.
Exit code 0: all is finished. 1: some failed. 2: bad usage. 130: interrupted.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import itertools
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.cli.arguments import number_from_zero, positive_integer
from fbrl.cli.errors import Parser, fail
from fbrl.cli.train import FAILED, INTERRUPTED
from fbrl.cli.train import parse as parse_training
from fbrl.collect.ray_cluster import connected_to_ray
from fbrl.config import ConfigError, TrainConfig
from fbrl.training.interrupt import Interrupt, Interrupted

PROGRAM = "sweep"
SECONDS_BETWEEN_LINES = 30.0
LOG_NAME = "output.log"
"""What fbrl-train printed, beside the run's directory."""


@dataclass(frozen=True)
class Point:
    """One training of a sweep.

    Attributes:
        run_dir: Its directory.
        arguments: Of fbrl-train, for its beginning.
        config: What they ask for.
    """

    run_dir: Path
    arguments: tuple[str, ...]
    config: TrainConfig

    def is_finished(self) -> bool:
        """Whether the training, and the evaluation at its end, are done."""
        from fbrl.checkpoint import CheckpointError, load_checkpoint

        if not has_checkpoint(self.run_dir):
            return False
        try:
            state = load_checkpoint(self.run_dir)
        except CheckpointError:
            return False
        is_evaluated = not self.config.eval_episodes or state["evaluated_at"] == state["frames"]
        return bool(state["frames"] >= self.config.ppo.total_frames and is_evaluated)

    def share_done(self) -> float:
        """How much of its frames is done, in [0, 1]."""
        try:
            frames = read_run_log(self.run_dir).frames[-1]
        except RunLogError:
            return 0.0
        return min(1.0, float(frames) / self.config.ppo.total_frames)


def has_checkpoint(run_dir: Path) -> bool:
    """Whether a training can go on there."""
    return any((run_dir / "checkpoints").glob("*.pt"))


def read_grid(path: Path, runs: Path) -> list[Point]:
    """The points of a grid, each checked as fbrl-train checks its command line.

    Raises:
        ValueError: It is no grid, or two points would have the same directory.
        OSError: The file can't be read.
    """
    try:
        options = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is no YAML: {error}") from error
    if not isinstance(options, dict) or "scenario" not in options:
        raise ValueError(f"{path} has no options of fbrl-train, with a scenario among them.")
    lists = {
        str(name): value if isinstance(value, list) else [value] for name, value in options.items()
    }
    varied = [name for name, values in lists.items() if len(values) > 1]
    points = []
    for values in itertools.product(*lists.values()):
        chosen = dict(zip(lists, values, strict=True))
        run_dir = runs / directory_name({name: chosen[name] for name in varied})
        arguments = training_arguments(chosen)
        config = parse_training([*arguments, "--run-dir", str(run_dir)])
        points.append(Point(run_dir, arguments, config))
    if len({point.run_dir for point in points}) < len(points):
        raise ValueError(f"Two points of {path} would have the same directory.")
    return points


def directory_name(values: Mapping[str, Any]) -> str:
    """A directory's name for the values by which a point differs from the others."""
    parts = [f"{name}={value}" for name, value in values.items()]
    return re.sub(r"[^\w=.,+-]+", "_", ",".join(parts)) or "run"


def training_arguments(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The command line of fbrl-train, but for the directory."""
    arguments = [str(values["scenario"])]
    for name, value in values.items():
        if value is True or value is False:
            arguments.append(f"--{name}" if value else f"--no-{name}")
        elif name != "scenario":
            arguments += [f"--{name}", *map(str, value if isinstance(value, list) else [value])]
    return tuple(arguments)


def run_training(run_dir: Path, arguments: Sequence[str], threads: int) -> int:
    """Begins a training, or goes on with it, in a process of its own; runs where Ray has room.

    When the task is cancelled, the training saves and ends.

    Returns:
        The exit code of fbrl-train.
    """
    program = str(Path(sys.executable).with_name("fbrl-train"))
    if has_checkpoint(run_dir):
        command = [program, "--resume", str(run_dir)]
    else:
        remove_false_start(run_dir)
        command = [program, *arguments, "--run-dir", str(run_dir)]
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    log_path = run_dir.with_name(f"{run_dir.name}.{LOG_NAME}")
    with log_path.open("ab") as log:
        process = subprocess.Popen(
            [*command, "--num-threads", str(threads)], stdout=log, stderr=log, env=os.environ
        )
        while True:
            try:
                # Ray's way to cancel a task doesn't wake a longer wait.
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return process.wait(0.5)
            except KeyboardInterrupt:
                process.terminate()


def remove_false_start(run_dir: Path) -> None:
    """Removes what a training left that ended before its first checkpoint.

    Raises:
        ConfigError: A process is training there.
    """
    from fbrl.training.run_dir import RunDirLock

    if run_dir.is_dir():
        with contextlib.closing(RunDirLock(run_dir)):
            shutil.rmtree(run_dir)


def sweep(points: Sequence[Point], cpus_per_run: int, gpus_per_run: float) -> int:
    """Runs the trainings that are not finished; returns the exit code."""
    import ray

    unfinished = [point for point in points if not point.is_finished()]
    print(f"{len(points)} trainings, {len(points) - len(unfinished)} of them finished.", flush=True)
    # A task whose node is lost is done again elsewhere, which goes on with its training.
    task = ray.remote(num_cpus=cpus_per_run, num_gpus=gpus_per_run)(run_training)
    references = [
        task.remote(point.run_dir.absolute(), point.arguments, cpus_per_run) for point in unfinished
    ]
    # In ray.wait an exception from a signal's handler would become another one.
    running = {
        reference.future(): point for reference, point in zip(references, unfinished, strict=True)
    }
    failed = 0
    with Interrupt() as interrupt:
        try:
            with interrupt.allowed():
                for point, outcome in outcomes(running):
                    failed += outcome != "finished"
                    print(f"{point.run_dir}: {outcome}", flush=True)
        except Interrupted:
            print("Interrupted: every training saves and ends.", flush=True)
            for reference in references:
                ray.cancel(reference)
            concurrent.futures.wait(running)
            return INTERRUPTED
    print(f"{len(points) - failed} of {len(points)} trainings are finished.", flush=True)
    return FAILED if failed else 0


def outcomes(running: dict[Future[int], Point]) -> Iterator[tuple[Point, str]]:
    """Each training as it ends, and how; lines about those that go on are printed meanwhile."""
    total, next_line = len(running), time.monotonic() + SECONDS_BETWEEN_LINES
    while running:
        ended, _ = concurrent.futures.wait(
            running, SECONDS_BETWEEN_LINES, concurrent.futures.FIRST_COMPLETED
        )
        for training in ended:
            point = running.pop(training)
            yield point, outcome_of(training, point)
        if running and time.monotonic() >= next_line:
            done = total - len(running) + sum(point.share_done() for point in running.values())
            print(f"{total - len(running)}/{total} ended, {done / total:.0%} of all frames.")
            next_line += SECONDS_BETWEEN_LINES


def outcome_of(training: Future[int], point: Point) -> str:
    """How a training ended, in words."""
    import ray

    try:
        code = training.result()
    except (ray.exceptions.RayError, ConfigError) as error:
        return f"failed: {str(error).strip().splitlines()[-1]}"
    log = point.run_dir.with_name(f"{point.run_dir.name}.{LOG_NAME}")
    return "finished" if code == 0 else f"failed with exit code {code}, see {log}"


def main() -> None:
    """Runs the command."""
    parser = Parser(prog=PROGRAM, description=__doc__)
    parser.add_argument("grid", type=Path, help="YAML file of options of fbrl-train")
    parser.add_argument("runs", type=Path, help="directory for the runs")
    parser.add_argument("--cpus-per-run", type=positive_integer, default=1)
    parser.add_argument("--gpus-per-run", type=number_from_zero, default=0.0, help="may be 0.25")
    options = parser.parse_args()
    try:
        points = read_grid(options.grid, options.runs)
        with connected_to_ray():
            code = sweep(points, options.cpus_per_run, options.gpus_per_run)
    except (ValueError, OSError) as error:
        fail(PROGRAM, error)
    sys.exit(code)


if __name__ == "__main__":
    main()
