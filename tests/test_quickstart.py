"""The quickstart's commands and Python, run as the page has them, but for shorter trainings."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

SHORTER = {
    "--total-frames 60000": "--total-frames 512 --num-envs 2 --num-steps 64 --eval-episodes 4",
    "--episodes 200": "--episodes 4",
    "episodes=20": "episodes=2",
    "rollout(50": "rollout(5",
}


def fenced(language: str) -> str:
    """All blocks of the page in a language, in their order, with the shorter sizes."""
    page = (REPOSITORY / "docs" / "quickstart.md").read_text()
    text = "\n".join(re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL))
    for as_written, shorter in SHORTER.items():
        text = text.replace(as_written, shorter)
    return text


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """Where the page's commands were run, one after the other."""
    directory = tmp_path_factory.mktemp("quickstart")
    programs = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-e", "-c", fenced("sh")],
        cwd=directory,
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return directory


def test_every_size_that_is_shortened_is_on_the_page():
    page = (REPOSITORY / "docs" / "quickstart.md").read_text()
    assert [size for size in SHORTER if size not in page] == []


@pytest.mark.slow
def test_the_commands_leave_what_the_page_says(directory):
    run = directory / "runs" / "first"
    for name in ("config.json", "metrics.csv", "evaluations.csv", "checkpoints/last.pt"):
        assert (run / name).is_file()
    assert len(list(run.glob("events.out.tfevents.*"))) == 1
    for name in ("first.csv", "first.mp4", "curve.png", "densities.png"):
        assert (directory / name).stat().st_size > 100


@pytest.mark.slow
def test_the_python_runs_after_them(directory):
    done = subprocess.run(
        [sys.executable, "-c", fenced("python")],
        cwd=directory,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"-?\d\.\d+ \[.+\] over \d+ matches", done.stdout)
