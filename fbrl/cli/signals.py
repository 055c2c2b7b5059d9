"""SIGINT and SIGTERM end a command, whatever it does at that moment."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

SECONDS_TO_TIDY_UP = 15.0
"""A match that hangs is waited for twice, five seconds each, before its error is passed on."""


@contextlib.contextmanager
def raising_keyboard_interrupt(on_no_end: Callable[[], None], exit_code: int) -> Iterator[None]:
    """Turns SIGINT and SIGTERM into ``KeyboardInterrupt``, and ends the process if it doesn't.

    Signals that were ignored on purpose stay so. Outside the main thread nothing is changed.

    Args:
        on_no_end: Called, in a thread of its own, :data:`SECONDS_TO_TIDY_UP` after a signal, just
            before the process is ended.
        exit_code: With which it is.
    """

    def end() -> None:
        try:
            on_no_end()
        finally:
            # Nothing else ends a process whose main thread is in the engine.
            os._exit(exit_code)

    timer = threading.Timer(SECONDS_TO_TIDY_UP, end)
    timer.daemon = True

    def handle(number: int, frame: Any) -> None:
        # A second signal breaks off the tidying up, but not its time limit.
        if timer.ident is None:
            timer.start()
        raise KeyboardInterrupt

    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                previous[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        timer.cancel()
        for number, handler in previous.items():
            signal.signal(number, handler)
