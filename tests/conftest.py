"""What several test modules share."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from written_runs import write_shooter

from fbrl import registry
from fbrl.envs import FootballVectorEnv
from fbrl.envs.engine import load_gfootball

REPOSITORY = Path(__file__).parent.parent
ENGINE_IS_INSTALLED = importlib.util.find_spec("fbrl_engine") is not None
needs_engine = pytest.mark.skipif(not ENGINE_IS_INSTALLED, reason="asks for the football engine")


def pytest_report_header():
    """Says at the top of the output why so many tests are skipped."""
    if not ENGINE_IS_INSTALLED:
        return "football engine: not installed; tests that ask for it are skipped"
    return None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Where no engine is installed, a test that fails for want of it counts as skipped.

    So no list of them has to be kept; only a test whose report doesn't show that the engine was
    missed, such as one of a program's exit code, is marked with ``needs_engine``.
    """
    report = yield
    if not ENGINE_IS_INSTALLED and report.failed:
        told = [report.longreprtext, *(text for _, text in report.sections)]
        if any("The football engine can't be imported" in text for text in told):
            report.outcome = "skipped"
            report.longrepr = (str(item.path), None, "Skipped: asks for the football engine")
    return report


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
    """Runs one of fbrl's commands as a user would, by default in an empty directory."""

    def run(*arguments, timeout=300, cwd=tmp_path):
        program = Path(sys.executable).with_name(arguments[0])
        return subprocess.run(
            [program, *map(str, arguments[1:])],
            cwd=cwd,
            env={**os.environ, "COLUMNS": "200"},
            capture_output=True,
            text=True,
            timeout=timeout,
        )

    return run


@pytest.fixture
def own_scenarios(tmp_path):
    """Gives a gfootball more scenarios, from their text, and leaves the installed one as it is.

    Returns the environment of a process that imports it.
    """

    def add(texts):
        package = Path(importlib.util.find_spec("gfootball").origin).parent
        scenarios = tmp_path / "own" / "gfootball" / "scenarios"
        scenarios.mkdir(parents=True)
        for folder in (package, package / "scenarios"):
            for path in folder.iterdir():
                link = tmp_path / "own" / "gfootball" / path.relative_to(package)
                if not link.exists():
                    link.symlink_to(path)
        for name, text in texts.items():
            (scenarios / f"{name}.py").write_text(text)
        paths = [str(tmp_path / "own"), *sys.path]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}

    return add


@pytest.fixture
def run_main(capsys, monkeypatch):
    """Runs the main function of one of fbrl's commands in this process.

    Each begins, as a process of its own would, with no module of one's own that may be named.
    """

    def run(main, *arguments, code=0):
        monkeypatch.setattr(sys, "path", [*sys.path])
        monkeypatch.setattr(registry, "_named", set())
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        assert ended.value.code == code, printed.err
        return printed

    return run


@pytest.fixture
def no_engine(monkeypatch):
    """Takes the engine away, so that whoever tries to play says so."""
    monkeypatch.setitem(sys.modules, "fbrl_engine", None)  # as if it were not installed
    load_gfootball.cache_clear()
    yield
    load_gfootball.cache_clear()


@pytest.fixture
def stop_after(monkeypatch):
    """Makes the matches send their process a signal after a number of steps, wherever that is."""
    left = [0]

    send_step = FootballVectorEnv.send_step

    def counting_send_step(self, *arguments):
        left[0] -= 1
        if left[0] == 0:
            signal.raise_signal(signal.SIGTERM)
        return send_step(self, *arguments)

    monkeypatch.setattr(FootballVectorEnv, "send_step", counting_send_step)

    def stop_after(steps):
        left[0] = steps

    return stop_after


@pytest.fixture(scope="session")
def shooter(tmp_path_factory):
    """A run whose agent nearly always shoots at an empty goal, and always does in greedy mode."""
    return write_shooter(tmp_path_factory.mktemp("shooter"))


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
