"""Notices a match that hangs: the thread that steps it can't tell, nor can it be ended."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

from fbrl.envs.engine import load_gfootball

_LOOKS = 10
"""In the time that a match may take."""


class Watchdog:
    """Looks, in a thread of its own, whether a step or a reset of a match takes too long.

    Time in which the whole process stood still, as in a job that was suspended, is not counted.

    Args:
        timeout: Seconds that one call of a match may take; 0 never to look.
        on_hang: Called once, in the watchdog's thread, with what hangs in words.

    Examples:
        >>> with Watchdog(60, on_hang=print):
        ...     pass  # step matches
    """

    def __init__(self, timeout: float, on_hang: Callable[[Sequence[str]], None]) -> None:
        self._timeout = timeout
        self._on_hang = on_hang
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> Watchdog:
        if self._timeout:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._timeout:
            self._thread.join()

    def _watch(self) -> None:
        in_hand = load_gfootball().engine.matches_in_hand
        looks: dict[tuple[Any, str], int] = {}
        while not self._ended.wait(self._timeout / _LOOKS):
            # Counted, not measured: a process that stands still does not look.
            looks = {call: looks.get(call, 0) + 1 for call in in_hand()}
            hanging = [match for (_, match), times in looks.items() if times > _LOOKS]
            if hanging:
                self._on_hang(sorted(hanging))
                return
