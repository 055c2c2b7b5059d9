"""What several test modules share."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent


@pytest.fixture(scope="session", autouse=True)
def signals_are_not_ignored():
    """A suite that runs in the background, or under nohup, inherits ignored signals."""
    for number, handler in {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.fixture
def run_program(tmp_path):
    """Runs one of fbrl's commands as a user would, in an empty directory."""

    def run(*arguments, timeout=300):
        program = Path(sys.executable).with_name(arguments[0])
        return subprocess.run(
            [program, *map(str, arguments[1:])],
            cwd=tmp_path,
            env={**os.environ, "COLUMNS": "200"},
            capture_output=True,
            text=True,
            timeout=timeout,
        )

    return run


@pytest.fixture(scope="session")
def wheel_file(tmp_path_factory):
    """fbrl's wheel, built from its source distribution, which is built from a copy of the clone."""
    directory = tmp_path_factory.mktemp("distributions")
    sources = directory / "sources"
    # A copy, so that a build never leaves anything in the clone.
    shutil.copytree(
        REPOSITORY / "fbrl", sources / "fbrl", ignore=shutil.ignore_patterns("__pycache__")
    )
    for path in REPOSITORY.iterdir():
        if path.is_file():
            shutil.copy(path, sources)
    built = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", directory, sources],
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (wheel,) = directory.glob("*.whl")
    return wheel
