"""Ending a training on a signal without leaving anything half done."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
"""What terminals and schedulers send to have a process end in order."""


class Interrupted(BaseException):
    """Raised inside :meth:`Interrupt.allowed` when the user asks for the end.

    Not an ``Exception``, so that no library's handling of errors swallows it.
    """


class Interrupt:
    """Turns Ctrl-C, SIGTERM, SIGHUP and SIGUSR1 into an orderly end.

    Schedulers send SIGTERM, or as Slurm's ``--signal=USR1@120`` asks for SIGUSR1, before they take
    a machine away.

    As a context manager it takes these signals over, except those that were ignored on purpose.
    The first one raises :class:`Interrupted` inside :meth:`allowed` blocks, at once or when the
    next one begins; elsewhere it only sets :attr:`requested`. A second Ctrl-C raises
    ``KeyboardInterrupt``, unless something is being saved; further other signals change nothing,
    because schedulers repeat them.

    Outside the main thread signals can't be taken over, and nothing is changed.

    Args:
        on_postponed: Called when a signal has to wait for the work in hand.

    Attributes:
        requested: A signal has come.
    """

    def __init__(self, on_postponed: Callable[[], None] = lambda: None) -> None:
        self.requested = False
        self._on_postponed = on_postponed
        self._allowed = False
        self._saving = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            for number in ENDING_SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if not self.requested:
            self.requested = True
            if self._allowed:
                raise Interrupted
            self._on_postponed()
        elif number == signal.SIGINT and not self._saving:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def allowed(self) -> Iterator[None]:
        """A block that may be left at any point, because nothing in it needs to be finished."""
        self._allowed = True
        try:
            if self.requested:
                raise Interrupted
            yield
        finally:
            self._allowed = False

    @contextlib.contextmanager
    def saving(self) -> Iterator[None]:
        """A block that no signal breaks off."""
        self._saving = True
        try:
            yield
        finally:
            self._saving = False
