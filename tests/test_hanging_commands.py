"""A command whose match hangs ends: by itself after a while, and in seconds when it is told to."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from conftest import needs_engine

from fbrl.cli import errors

pytestmark = [needs_engine, pytest.mark.slow]

# The third step never returns; two timeouts in place of the command's own.
HANGING = """
import importlib, sys
from fbrl.cli import errors
from fbrl.config import TrainConfig
from fbrl.envs.engine import load_gfootball
from fbrl.envs.matches import Matches

program, timeout, seconds_to_tidy_up, *arguments = sys.argv[1:]
steps, step = [], Matches.step

def hanging_step(self, matches, actions):
    steps.append(actions)
    if len(steps) == 3:
        self.native.disturb(load_gfootball().engine.Disturbance("hang"))
        print("hanging", flush=True)
    step(self, matches, actions)

Matches.step = hanging_step
errors.SECONDS_TO_TIDY_UP = float(seconds_to_tidy_up)
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

    def hang(program, line, timeout, seconds_to_tidy_up=errors.SECONDS_TO_TIDY_UP):
        seconds = (str(timeout), str(seconds_to_tidy_up))
        process = subprocess.Popen(
            [sys.executable, "-c", HANGING, program, *seconds, *line.split()],
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
    process = hang(program, PLAYED[program], timeout=1)
    _, told = process.communicate(timeout=40)
    assert process.returncode == 1
    assert told.startswith(f"fbrl-{program}: error: The engine hangs: match 0 of academy_corner")
    assert "took more than 1 s" in told
    assert told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_it_ends_the_matches_that_are_played_for_a_picture(hang, shooter, tmp_path):
    there = sorted(tmp_path.iterdir())
    process = hang("density", f"plot agent --run {shooter} --episodes 2 --out a.png", timeout=1)
    _, told = process.communicate(timeout=40)
    assert process.returncode == 1
    assert "fbrl-density: error: The engine hangs: match 0" in told
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.parametrize(
    ("program", "number"), [("eval", signal.SIGTERM), ("watch", signal.SIGINT)]
)
def test_a_signal_ends_a_command_that_hangs_in_seconds(program, number, hang, tmp_path):
    process = hang(program, PLAYED[program], timeout=600, seconds_to_tidy_up=3)
    started = time.monotonic()
    process.send_signal(number)
    _, told = process.communicate(timeout=40)
    assert (process.returncode, told) == (130, f"fbrl-{program}: interrupted\n")
    assert time.monotonic() - started < 13
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
    _, told = process.communicate(timeout=20)
    assert (process.returncode, told) == (130, "fbrl-deaf: interrupted\n")
