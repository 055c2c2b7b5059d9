"""A command whose match hangs ends: by itself after a while, and in seconds when it is told to."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from conftest import needs_engine

pytestmark = [needs_engine, pytest.mark.slow]

# The third step never returns; a timeout in place of the command's own.
HANGING = """
import importlib, sys
from fbrl.config import TrainConfig
from fbrl.envs.engine import load_gfootball
from fbrl.envs.matches import Matches

program, timeout, *arguments = sys.argv[1:]
steps, step = [], Matches.step

def hanging_step(self, matches, actions):
    steps.append(actions)
    if len(steps) == 3:
        self.native.disturb(load_gfootball().engine.Disturbance("hang"))
        print("hanging", flush=True)
    step(self, matches, actions)

Matches.step = hanging_step
TrainConfig.hang_timeout = float(timeout)
importlib.import_module(f"fbrl.cli.{program}").main(arguments)
"""
PLAYED = {
    "eval": "--policy idle --scenario academy_corner --episodes 2 --csv a.csv",
    "watch": "--policy idle --scenario academy_corner --out a.mp4",
}


@pytest.fixture
def hang(tmp_path):
    """Begins a command whose match hangs."""

    def hang(program, timeout, line):
        process = subprocess.Popen(
            [sys.executable, "-c", HANGING, program, str(timeout), *line.split()],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout.readline() == "hanging\n"
        return process

    return hang


@pytest.mark.parametrize("program", PLAYED)
def test_a_match_that_hangs_is_named_and_ends_the_command(program, hang, tmp_path):
    process = hang(program, 1, PLAYED[program])
    _, errors = process.communicate(timeout=40)
    assert process.returncode == 1
    assert errors.startswith(f"fbrl-{program}: error: The engine hangs: match 0 of academy_corner")
    assert "took more than 1 s" in errors
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_it_ends_the_matches_that_are_played_for_a_picture(hang, shooter, tmp_path):
    there = sorted(tmp_path.iterdir())
    process = hang("density", 1, f"plot agent --run {shooter} --episodes 2 --out a.png")
    _, errors = process.communicate(timeout=40)
    assert process.returncode == 1
    assert "fbrl-density: error: The engine hangs: match 0" in errors
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.parametrize(
    ("program", "number"), [("eval", signal.SIGTERM), ("watch", signal.SIGINT)]
)
def test_a_signal_ends_a_command_that_hangs_in_seconds(program, number, hang, tmp_path):
    process = hang(program, 600, PLAYED[program])
    started = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=40)
    assert (process.returncode, errors) == (130, f"fbrl-{program}: interrupted\n")
    assert time.monotonic() - started < 25
    assert list(tmp_path.iterdir()) == []


DEAF = """
import time
from fbrl.cli import errors

errors.SECONDS_TO_TIDY_UP = 0.5
with errors.ending_when_interrupted("fbrl-deaf"):
    while True:
        try:
            print("begun", flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            pass
"""


def test_what_hears_no_signal_is_ended_all_the_same():
    process = subprocess.Popen(
        [sys.executable, "-c", DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (130, "fbrl-deaf: interrupted\n")
