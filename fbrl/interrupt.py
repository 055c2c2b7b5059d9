"""Ending a training on a signal without leaving anything half done."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Any


class Interrupted(Exception):  # noqa: N818 (an event, not an error)
    """Raised inside :meth:`Interrupt.allowed` when the user asks for the end."""


class Interrupt:
    """Turns Ctrl-C and SIGTERM into an orderly end.

    As a context manager it takes the two signals over. The first one raises
    :class:`Interrupted` inside :meth:`allowed` blocks, at once or when the next one begins;
    elsewhere it only sets :attr:`requested`. A second one raises ``KeyboardInterrupt``.

    Outside the main thread signals can't be taken over, and nothing is changed.

    Attributes:
        requested: A signal has come.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self.requested = False
        self._allowed = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            for number in self._SIGNALS:
                self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        if self._allowed:
            raise Interrupted

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
