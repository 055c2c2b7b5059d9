"""Contestants that take turns, each in a fresh process: A B C, A B C, and so on.

What slows the machine down for a while then slows all of them down, and the ratio of two of them,
taken within a round, is fair; medians over the rounds leave out the odd disturbance.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.builds import Build, worker_environment

TIMEOUT = 900
"""Seconds after which a worker is given up."""


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

    Each function gets the number of the round as its ``seed``, so that all contestants of a
    round have the same work.

    Raises:
        WorkerError: A measurement failed.
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
                cwd=Path(__file__).parent.parent,
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
