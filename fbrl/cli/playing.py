"""A match that hangs ends the command that plays it."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator, Sequence

from fbrl.cli.errors import FAILED, fail
from fbrl.collect.watchdog import Watchdog
from fbrl.config import TrainConfig
from fbrl.envs.engine import load_gfootball

HANG_TIMEOUT: float = TrainConfig.hang_timeout
"""Seconds that a step or a reset of a match may take, as in a training."""


@contextlib.contextmanager
def playing(program: str) -> Iterator[None]:
    """Ends the command with one line on stderr and exit code 1 where a match hangs.

    Args:
        program: Name of the command, which answers SIGINT as
            :func:`fbrl.cli.errors.ending_when_interrupted` does.

    Raises:
        EngineNotInstalledError: gfootball is missing.
    """
    load_gfootball()
    hanging: list[str] = []

    def end(matches: Sequence[str]) -> None:
        hanging.extend(matches)
        # What is being written is tidied up, as after Ctrl-C.
        signal.raise_signal(signal.SIGINT)

    try:
        with Watchdog(HANG_TIMEOUT, end):
            yield
    except KeyboardInterrupt:
        if not hanging:
            raise
        took = f"took more than {HANG_TIMEOUT:g} s"
        fail(program, f"The engine hangs: {', '.join(hanging)} {took}. Try another seed.", FAILED)
