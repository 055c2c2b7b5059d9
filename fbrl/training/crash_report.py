"""What a crash of the process leaves behind: where each thread was."""

from __future__ import annotations

import contextlib
import faulthandler
import os
from pathlib import Path

from fbrl.run_files import REPORT_NAME


class CrashReport:
    """Has the stacks of all threads written into a file if the process crashes.

    As a context manager it takes Python's :mod:`faulthandler` over, which answers segmentation
    faults, aborts and the like, unless somebody else uses it. At an orderly end the empty file
    goes; after a crash it stays, and after kill -9 too, empty.

    Args:
        run_dir: The run's directory; it must exist.

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
    """Gives the report of a crash a name of its own; None if there was no crash.

    Args:
        run_dir: The run's directory.
        number: Of the crash, for the name.

    Raises:
        OSError: It can't be renamed.
    """
    report = run_dir / REPORT_NAME
    if not report.is_file() or not report.stat().st_size:
        return None
    return report.replace(run_dir / f"crash-{number}.txt")
