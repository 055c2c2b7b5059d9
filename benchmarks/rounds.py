"""Contestants that take turns, each in a fresh process: A B C, A B C, and so on.

What slows the machine down for a while then slows all of them down, and the ratio of two of them,
taken within a round, is fair; medians over the rounds leave out the odd disturbance.
"""

from __future__ import annotations

import enum
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fbrl.allocator import environment_with_tcmalloc, reason_against_tcmalloc

REPOSITORY = Path(__file__).parent.parent
DEFAULT_ENGINE = REPOSITORY / "build" / "default-engine"
"""gfootball as pip compiles it, where ``scripts/setup.sh --default-engine`` puts it."""

_SETTINGS = ("OMP_WAIT_POLICY", "LD_PRELOAD", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

TIMEOUT = 900
"""Seconds after which a worker is given up."""


class Build(enum.Enum):
    """An engine and the way in which a program runs on it."""

    FBRL = "fbrl"
    """The engine that fbrl's set-up builds, run as fbrl's commands run it: with tcmalloc where it
    is installed, and with threads of PyTorch that don't spin while they wait."""

    DEFAULT = "default"
    """The engine as pip builds it by default, run as any Python program."""

    @property
    def is_there(self) -> bool:
        """Whether a worker could run on it."""
        return self is Build.FBRL or DEFAULT_ENGINE.is_dir()


def worker_environment(build: Build) -> dict[str, str]:
    """The environment variables of a worker: the user's, without what decides on speed."""
    environment = {name: value for name, value in os.environ.items() if name not in _SETTINGS}
    # A worker on the one build may have another one on the other.
    paths = environment.get("PYTHONPATH", "").split(os.pathsep)
    paths = [path for path in paths if path and path != str(DEFAULT_ENGINE)]
    if build is Build.DEFAULT:
        paths = [str(DEFAULT_ENGINE), *paths]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    if build is Build.FBRL:
        environment["OMP_WAIT_POLICY"] = "PASSIVE"
        if reason_against_tcmalloc(environment) is None:
            environment = environment_with_tcmalloc(environment)
    return environment


class WorkerError(RuntimeError):
    """Raised when a measurement failed; the message ends with what it last printed."""


@dataclass(frozen=True)
class Contestant:
    """Something to be measured.

    Attributes:
        case: What is done, the same for all that are compared with each other.
        name: Who does it.
        function: ``"module:function"``, called in the worker; returns figures by name.
        arguments: Its keyword arguments, as JSON knows them.
        build: The engine, and what is preloaded, that the worker runs on.
        single_core: Leave the worker one core only.
        first_round_only: Measure it once; for what only explains the others.
    """

    case: str
    name: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    build: Build = Build.FBRL
    single_core: bool = False
    first_round_only: bool = False


@dataclass(frozen=True)
class Row:
    """One figure of one contestant in one round."""

    case: str
    name: str
    round: int
    figure: str
    value: float


def run_rounds(
    contestants: Sequence[Contestant], repeats: int, on_progress: Callable[[str], None]
) -> Iterator[Row]:
    """Runs all contestants in turn, ``repeats`` times over.

    Each function gets the number of the round, from 1 on, as its ``seed``, so that all contestants
    of a round have the same work.
    """
    turns = [
        (number, contestant)
        for number in range(repeats)
        for contestant in contestants
        if number == 0 or not contestant.first_round_only
    ]
    started = time.perf_counter()
    for done, (number, contestant) in enumerate(turns, 1):
        figures = run_worker(contestant, seed=number + 1)
        for figure, value in figures.items():
            yield Row(contestant.case, contestant.name, number, figure, value)
        shown = ", ".join(f"{figure} {value:.4g}" for figure, value in figures.items())
        on_progress(
            f"{done}/{len(turns)}, {time.perf_counter() - started:.0f} s: "
            f"{contestant.case}, {contestant.name}: {shown}"
        )


def run_worker(contestant: Contestant, seed: int) -> dict[str, Any]:
    """Measures a contestant once, in a process of its own.

    Raises:
        WorkerError: It failed, or took longer than :data:`TIMEOUT`.
    """
    request = {
        "function": contestant.function,
        "arguments": {**contestant.arguments, "seed": seed},
        "single_core": contestant.single_core,
    }
    with tempfile.TemporaryDirectory(prefix="fbrl-benchmark-") as directory:
        result = Path(directory) / "figures.json"
        try:
            process = subprocess.run(
                [sys.executable, "-m", "benchmarks.worker", str(result)],
                input=json.dumps(request),
                env=worker_environment(contestant.build),
                cwd=REPOSITORY,
                capture_output=True,
                text=True,
                timeout=TIMEOUT,
            )
        except subprocess.TimeoutExpired as error:
            raise WorkerError(
                f"{contestant.case}, {contestant.name}: no result after {TIMEOUT} s."
            ) from error
        if process.returncode or not result.exists():
            raise WorkerError(
                f"{contestant.case}, {contestant.name}: exit status {process.returncode}.\n"
                f"{process.stdout[-2000:]}{process.stderr[-4000:]}"
            )
        figures: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        return figures
