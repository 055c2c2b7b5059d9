"""Programs that play on one engine, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from episodes import Episode

DRIVER = Path(__file__).with_name("play_matches.py")


class EnginePlayError(RuntimeError):
    """An engine's process ended before it had played what it was to play."""


def engine_environment(
    engine: Path | None, variables: dict[str, str] | None = None
) -> dict[str, str]:
    """Variables of a process that plays on an engine."""
    environment = {**os.environ, **(variables or {})}
    environment.pop("PYTHONPATH", None)
    if engine is not None:
        environment["PYTHONPATH"] = str(engine)
    return environment


def play(
    engine: Path | None,
    episodes: Iterable[Episode],
    *options: str,
    environment: dict[str, str] | None = None,
) -> Iterator[dict[str, Any]]:
    """Plays episodes in a process of its own.

    Args:
        engine: Directory with the packages ``gfootball`` and ``gfootball_engine``; by default the
            ones that are installed are taken.
        episodes: What to play.
        options: Of ``play_matches.py``.
        environment: Variables of the process, besides those of this one.

    Yields:
        The lines that it prints, the first and the last one included.

    Raises:
        EnginePlayError: It ended early.
    """
    with (
        tempfile.TemporaryFile("w+") as wanted,
        tempfile.TemporaryFile("w+", errors="replace") as errors,
    ):
        wanted.writelines(json.dumps(asdict(episode)) + "\n" for episode in episodes)
        wanted.seek(0)
        process = subprocess.Popen(
            [sys.executable, DRIVER, *options],
            env=engine_environment(engine, environment),
            stdin=wanted,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        assert process.stdout
        done = False
        try:
            for line in process.stdout:
                values = json.loads(line)
                done = "done" in values
                yield values
        except BaseException:
            process.kill()  # Nobody reads on.
            raise
        finally:
            process.stdout.close()
            process.wait()
        if not done:
            errors.seek(0)
            raise EnginePlayError(
                f"The engine of {engine or 'this environment'} ended early, with exit code "
                f"{process.returncode}: {errors.read()[-2000:].strip() or 'it printed nothing'}"
            )
