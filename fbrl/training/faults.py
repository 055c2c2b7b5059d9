"""What ends a training before its end: signals, crashes, and an engine that hangs."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from fbrl.run_files import REPORT_NAME
from fbrl.training.run_dir import RunDirReplacedError

if TYPE_CHECKING:
    from fbrl.training.run_checkpoints import RunCheckpoints

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
"""What terminals and schedulers send to have a process end in order; SIGUSR1 is Slurm's, with
``--signal=USR1@60``."""

HUNG = 1
"""Exit code of a process in which the engine hangs."""


class Interrupted(BaseException):
    """Raised inside :meth:`Interrupt.allowed` when the user asks for the end.

    Not an ``Exception``, so that no library's handling of errors swallows it.
    """


class Interrupt:
    """Turns Ctrl-C, SIGTERM, SIGHUP and SIGUSR1 into an orderly end.

    As a context manager it takes these signals over, except those that were ignored on purpose.
    The first one raises :class:`Interrupted` inside :meth:`allowed` blocks, at once or when the
    next one begins; elsewhere it only sets :attr:`requested`. A second Ctrl-C raises
    ``KeyboardInterrupt``, unless something is being saved; further other signals change nothing,
    because schedulers repeat them. Outside the main thread signals can't be taken over, and nothing
    is changed. ``on_postponed`` is called when a signal has to wait for the work in hand.
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


class CrashReport:
    """Has the stacks of all threads written into a file if the process crashes.

    As a context manager it takes Python's :mod:`faulthandler` over, which answers segmentation
    faults, aborts and the like, unless somebody else uses it. At an orderly end the empty file
    goes; after a crash it stays, and after kill -9 too, empty.

    Raises:
        OSError: The file can't be made.
    """

    def __init__(self, run_dir: Path) -> None:
        self.path = run_dir / REPORT_NAME
        self._file = self.path.open("wb", buffering=0)
        self._enabled = False

    def __enter__(self) -> CrashReport:
        self._enabled = not faulthandler.is_enabled()
        if self._enabled:
            faulthandler.enable(self._file)
        return self

    def __exit__(self, *_: object) -> None:
        if self._enabled:
            faulthandler.disable()
        with self._file as file, contextlib.suppress(OSError):
            # One that was deleted may be another training's by now.
            is_there = os.fstat(file.fileno()).st_nlink > 0
            if is_there and not file.tell():
                self.path.unlink()

    def write(self, reason: str) -> None:
        """Writes where each thread is at this moment, without a crash.

        Raises:
            OSError: The file can't be written.
        """
        self._file.write(f"{reason}\n\n".encode())
        faulthandler.dump_traceback(self._file)


def set_crash_report_aside(run_dir: Path, number: int) -> Path | None:
    """Renames the report of a crash to ``crash-{number}.txt``; None if there was no crash.

    Raises:
        OSError: It can't be renamed.
    """
    report = run_dir / REPORT_NAME
    if not report.is_file() or not report.stat().st_size:
        return None
    return report.replace(run_dir / f"crash-{number}.txt")


def end_hung(
    matches: Sequence[str],
    timeout: float,
    report: CrashReport,
    checkpoints: RunCheckpoints,
    on_hang: Callable[[str], None],
) -> None:
    """Saves a training as it was at the beginning of the batch, and ends the process.

    With a batch that is collected ahead, the end of the update meanwhile is waited for as long as
    for a match: the timeout, in seconds.
    """
    reason = f"The engine hangs: {', '.join(matches)} took more than {timeout} s."
    try:
        # Also the mark by which the training goes on with other matches.
        report.write(reason)
        checkpoints.save_hung(timeout)
    except (OSError, RunDirReplacedError) as error:
        checkpoints.on_warning(str(error))
    finally:
        # Whatever can't be said: nothing else ends a process with a thread in the engine.
        try:
            on_hang(f"{reason} See {report.path}; {checkpoints.what_is_saved()}.")
        finally:
            os._exit(HUNG)
