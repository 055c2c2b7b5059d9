"""Checks of an installation, part by part, each with a remedy for what it finds wrong.

Each check runs in a Python process of its own with a time limit, since a broken compiled library
may end the interpreter or hang, and one broken part shall not hide the others. ``python -m
fbrl.doctor NAME`` is such a process; users call the command ``fbrl-doctor``.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from fbrl.doctor.checks import CHECKS, RENDERING, Check, CheckError, Status

__all__ = [
    "CHECKS",
    "RENDERING",
    "Check",
    "CheckError",
    "CheckResult",
    "installation_works",
    "run_check",
    "run_checks",
]

RESULT_MARKER = "FBRL-DOCTOR-RESULT "
# The engine prints to the same stream, without a newline at times.
_RESULT_PATTERN = re.compile(re.escape(RESULT_MARKER) + r"(\{.*\})")


@dataclass(frozen=True)
class CheckResult:
    """What a check found.

    Attributes:
        name: Name of the check.
        status: ``"ok"``, ``"warn"`` or ``"fail"``.
        detail: What was found, in one line.
        remedy: What mends it; empty where nothing has to be mended.
        seconds: How long the check took, its process included.
    """

    name: str
    status: Status
    detail: str
    remedy: str = ""
    seconds: float = 0.0


def run_check(check: Check) -> CheckResult:
    """Runs a check in a process of its own; never raises for what the check does."""
    started = time.perf_counter()
    status, detail, remedy = _outcome_in_process(check)
    if status == "fail" and not check.needed:
        status = "warn"
    seconds = round(time.perf_counter() - started, 2)
    return CheckResult(check.name, status, detail, remedy, seconds)


def _outcome_in_process(check: Check) -> tuple[Status, str, str]:
    # A file of the user's working directory must not be imported in a module's place.
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    # Headless means that no X server is asked, a dead one of an old login least of all.
    environment.pop("DISPLAY", None)
    try:
        process = subprocess.run(
            [sys.executable, "-m", "fbrl.doctor", check.name],
            capture_output=True,
            text=True,
            errors="replace",
            env=environment,
            timeout=check.time_limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "fail", f"no answer within {check.time_limit:g} s", check.remedy
    if match := _RESULT_PATTERN.search(process.stdout):
        result = json.loads(match[1])
        return result["status"], result["detail"], result["remedy"]
    last_line = (process.stderr.strip() or "no output").splitlines()[-1]
    if process.returncode < 0:
        ending = f"crashed with {signal.Signals(-process.returncode).name}"
    else:
        ending = f"ended with status {process.returncode}"
    return "fail", f"{ending}: {last_line}", check.remedy


def run_checks(checks: Iterable[Check]) -> Iterator[CheckResult]:
    """Runs checks side by side; yields their results in the order of the checks."""
    pool = ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1))
    try:
        yield from pool.map(run_check, checks)
    finally:
        # After an interruption no other check is begun.
        pool.shutdown(cancel_futures=True)


def installation_works(results: Iterable[CheckResult]) -> bool:
    """Whether nothing that training needs has failed."""
    return all(result.status != "fail" for result in results)
