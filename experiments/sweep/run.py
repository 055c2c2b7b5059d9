"""Trains an agent for each point of a grid, on a Ray cluster or on this machine alone."""

from __future__ import annotations

import concurrent.futures
import contextlib
import ctypes
import functools
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from datetime import timedelta
from pathlib import Path

from grid import Point, print_summary, read_grid

from fbrl.cli.arguments import number_from_zero, positive_integer
from fbrl.cli.errors import FAILED, INTERRUPTED, Parser, ending_when_interrupted, fail
from fbrl.collect.ray_cluster import connected_to_ray
from fbrl.config import ConfigError
from fbrl.files.csv_table import read_csv_table
from fbrl.training.faults import Interrupt, Interrupted

PROGRAM = "sweep"
SECONDS_BETWEEN_LINES = 30.0
SECONDS_TO_END = 120
"""That a training which is being ended by an earlier call may take to save."""

DESCRIPTION = """\
Train an agent for each point of a grid, on a Ray cluster or on this machine alone.

The grid is a YAML file of options of fbrl-train without their dashes. A list is gone through, and
each combination of the lists is one training with a directory of its own below RUNS:

  scenario: [academy_3_vs_1_with_keeper, academy_counterattack_easy]
  reward: [analytics, scoring]
  seed: [0, 1, 2]
  total-frames: 400000

makes RUNS/scenario=academy_counterattack_easy,reward=scoring,seed=2 and eleven others. All of it is
checked before the first training begins. What fbrl-train prints is beside each run, in
RUNS/....output.log.

The same command again skips what is finished and goes on with what is not: after an interruption,
after a failure, and with more seeds or frames in the grid. Ctrl-C, SIGTERM and SIGUSR1 let every
training save and end."""

EPILOG = """\
examples:
  python experiments/sweep/run.py grid.yaml runs/sweep
  python experiments/sweep/run.py grid.yaml runs/sweep --cpus-per-run 4
  python experiments/sweep/run.py grid.yaml runs/sweep --cpus-per-run 8 --gpus-per-run 0.25
  RAY_ADDRESS=node1:6379 python experiments/sweep/run.py grid.yaml /shared/sweep

The cluster is that of RAY_ADDRESS, or the one that `ray start` has started on this machine; without
either all is done on this machine. RUNS has to be on a file system that all nodes share.

exit code 0: all is finished; 1: some failed, the others are finished; 2: bad usage, nothing was
begun; 130: interrupted"""


def run_training(run_dir: Path, arguments: Sequence[str], total_frames: int, threads: int) -> int:
    """Begins a training, or goes on with it, in a process of its own; runs where Ray has room.

    When the task is cancelled, and when Ray's process dies, the training saves and ends. Returns
    the exit code of fbrl-train.
    """
    program = str(Path(sys.executable).with_name("fbrl-train"))
    if has_checkpoint(run_dir):
        command = [program, "--resume", str(run_dir), "--total-frames", str(total_frames)]
    else:
        command = [program, *arguments, "--run-dir", str(run_dir)]
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    with run_dir.with_name(f"{run_dir.name}.output.log").open("ab") as log:
        command += ["--num-threads", str(threads)]
        process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=end_with_parent())
        while True:
            try:
                # Ray's way to cancel a task doesn't wake a longer wait.
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return process.wait(0.5)
            except KeyboardInterrupt:
                process.terminate()


def end_with_parent() -> Callable[[], object]:
    """For a new process: the kernel sends it SIGTERM when its parent ends, however that happens."""
    pr_set_pdeathsig = 1  # linux/prctl.h
    # The library is loaded here, before the fork, after which only system calls are safe.
    return functools.partial(ctypes.CDLL(None).prctl, pr_set_pdeathsig, int(signal.SIGTERM))


def has_checkpoint(run_dir: Path) -> bool:
    """Waits for a training that is being ended; whether there is a checkpoint to go on from.

    Raises:
        ConfigError: Another process is training there, and does not end.
    """
    from fbrl.training.run_dir import RunDirLock

    give_up = time.monotonic() + SECONDS_TO_END
    while run_dir.is_dir():
        try:
            with contextlib.closing(RunDirLock(run_dir)):
                return any((run_dir / "checkpoints").glob("*.pt"))
        except ConfigError:
            if time.monotonic() > give_up:
                raise
            time.sleep(1)
    return False


def unless_in(table: Path, points: Sequence[Point]) -> list[Point]:
    """The points that no row of a table names.

    Raises:
        ValueError: It is no table with a column "policy", or it names all of them.
        OSError: It can't be read.
    """
    read = read_csv_table(table)
    if "policy" not in read.columns:
        raise ValueError(f"{table} has no column policy, but {', '.join(read.columns)}.")
    finished = {row["policy"] for row in read.rows}
    left = [point for point in points if point.run_dir.name not in finished]
    if not left:
        raise ValueError(f"All {len(points)} trainings of the grid are in {table}.")
    print(f"{len(points) - len(left)} trainings are in {table} and left out.")
    return left


def sweep(points: Sequence[Point], cpus_per_run: int, gpus_per_run: float) -> int:
    """Runs the trainings that are not finished; returns the exit code.

    Raises:
        ConfigError: No node of the cluster has room for one of them.
    """
    import ray

    check_room(cpus_per_run, gpus_per_run)
    unfinished = [point for point in points if not point.is_finished()]
    begun = sum(point.has_begun() for point in unfinished)
    print(
        f"{len(points)} trainings: {len(points) - len(unfinished)} are finished and skipped, "
        f"{begun} go on, {len(unfinished) - begun} begin.",
        flush=True,
    )
    # A task whose node is lost is done again elsewhere, which goes on with its training.
    task = ray.remote(num_cpus=cpus_per_run, num_gpus=gpus_per_run)(run_training)
    references = [
        task.remote(
            point.run_dir.absolute(), point.arguments, point.config.ppo.total_frames, cpus_per_run
        )
        for point in unfinished
    ]
    # In ray.wait an exception from a signal's handler would become another one.
    futures = (reference.future() for reference in references)
    running = dict(zip(futures, unfinished, strict=True))
    failures: dict[Point, str] = {}
    with Interrupt() as interrupt:
        try:
            with interrupt.allowed():
                for point, outcome in outcomes(running):
                    print(f"{point.run_dir}: {outcome}", flush=True)
                    if outcome != "finished":
                        failures[point] = outcome
        except Interrupted:
            print("Interrupted: every training saves and ends.", flush=True)
            for reference in references:
                ray.cancel(reference)
            concurrent.futures.wait(running)
            print("All are saved. Go on with the same command.", flush=True)
            return INTERRUPTED
    print_summary(points, failures)
    return FAILED if failures else 0


def check_room(cpus: int, gpus: float) -> None:
    """Checks that a training fits on a node, which Ray would wait for without end.

    Raises:
        ConfigError: It fits on none.
    """
    import ray

    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if not any(node.get("CPU", 0) >= cpus and node.get("GPU", 0) >= gpus for node in nodes):
        found = "; ".join(f"{node.get('CPU', 0):g} and {node.get('GPU', 0):g}" for node in nodes)
        raise ConfigError(
            f"No node of the Ray cluster has room for a training with {cpus} CPUs and {gpus:g} "
            f"GPUs: they have {found}. Set --cpus-per-run and --gpus-per-run lower."
        )


def outcomes(running: dict[Future[int], Point]) -> Iterator[tuple[Point, str]]:
    """Each training as it ends, and how; lines about those that go on are printed meanwhile."""
    total = sum(point.config.ppo.total_frames for point in running.values())
    trainings, began = len(running), time.monotonic()
    before = sum(point.frames_done() for point in running.values())
    ended_frames, next_line = 0, began + SECONDS_BETWEEN_LINES
    while running:
        patience = max(0, next_line - time.monotonic())
        ended, _ = concurrent.futures.wait(running, patience, concurrent.futures.FIRST_COMPLETED)
        for training in ended:
            point = running.pop(training)
            ended_frames += point.frames_done()
            yield point, outcome_of(training, point)
        if running and time.monotonic() >= next_line:
            done = ended_frames + sum(point.frames_done() for point in running.values())
            speed = (done - before) / (time.monotonic() - began)
            left = f", {timedelta(seconds=round((total - done) / speed))} left" if speed > 0 else ""
            print(
                f"{trainings - len(running)} of {trainings} ended; {done:,} of {total:,} frames, "
                f"{speed:,.0f} a second{left}.",
                flush=True,
            )
            next_line += SECONDS_BETWEEN_LINES


def outcome_of(training: Future[int], point: Point) -> str:
    """How a training ended, in words."""
    import ray

    try:
        code = training.result()
    except (ray.exceptions.RayError, ConfigError) as error:
        return f"failed: {str(error).strip().splitlines()[-1]}"
    if code == 0:
        return "finished"
    lines = point.log.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line for line in reversed(lines) if line.strip()), "nothing was printed")
    how = f"with exit code {code}" if code > 0 else f"by {signal.Signals(-code).name}"
    return f"failed {how} ({last.strip()}), see {point.log}"


def main() -> None:
    """Runs the command."""
    parser = Parser(prog=PROGRAM, description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("grid", type=Path, metavar="GRID", help="YAML file, see above")
    parser.add_argument("runs", type=Path, metavar="RUNS", help="directory for the runs")
    parser.add_argument(
        "--cpus-per-run",
        type=positive_integer,
        default=1,
        metavar="N",
        help="what Ray reserves for a training, and its --num-threads (default: 1)",
    )
    parser.add_argument(
        "--gpus-per-run",
        type=number_from_zero,
        default=0.0,
        metavar="X",
        help="the same of GPUs; with 0.25 four trainings share one (default: 0)",
    )
    parser.add_argument(
        "--skip",
        type=Path,
        metavar="TABLE",
        help="CSV table whose column policy names runs that are finished, such as results.csv of "
        "experiments/thesis: they are left out, even where their directories are gone",
    )
    options = parser.parse_args()
    with ending_when_interrupted(PROGRAM):
        try:
            points = read_grid(options.grid, options.runs)
            if options.skip is not None:
                points = unless_in(options.skip, points)
            with connected_to_ray():
                code = sweep(points, options.cpus_per_run, options.gpus_per_run)
        except (ValueError, OSError) as error:
            fail(PROGRAM, error)
    sys.exit(code)


if __name__ == "__main__":
    main()
