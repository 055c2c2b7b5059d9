"""What hangs is told from what is only slow, and from a process that stood still."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from fbrl.collect.watchdog import Watchdog
from fbrl.envs.engine import load_gfootball
from fbrl.envs.matches import Matches


@pytest.fixture
def matches():
    matches = Matches("academy_empty_goal", 2, 2, ["ball"])
    for match in range(2):
        matches.prepare(match, match, 2)
    matches.begin([0, 1])
    yield matches
    matches.close()


def sleep_in_each_step(matches, seconds, engine_seed=None):
    disturbance = load_gfootball().engine.Disturbance("sleep", engine_seed, seconds)
    matches.native.disturb(disturbance)


def test_a_step_that_takes_too_long_is_named_once(matches):
    named, seen = [], threading.Event()

    def on_hang(matches):
        named.append(list(matches))
        seen.set()

    with Watchdog(0.2, on_hang):
        sleep_in_each_step(matches, 1.0, engine_seed=1)
        matches.step([0, 1], [5, 5])
        assert seen.is_set()
        matches.native.disturb(None)
        matches.step([0, 1], [5, 5])
    assert named == [["match 1 of academy_empty_goal (engine seed 1, episode 2)"]]


def test_many_short_steps_are_no_long_one(matches):
    named = []
    sleep_in_each_step(matches, 0.01)
    with Watchdog(0.2, named.append):
        for _ in range(40):
            matches.step([0, 1], [5, 5])
    assert named == []


def test_it_can_be_turned_off(matches):
    sleep_in_each_step(matches, 0.05)
    with Watchdog(0, None):
        matches.step([0, 1], [5, 5])


def test_a_step_that_fails_is_no_longer_in_hand(matches):
    engine = load_gfootball().engine
    matches.native.disturb(engine.Disturbance("throw"))
    with pytest.raises(RuntimeError, match="a fault that was asked for"):
        matches.step([0, 1], [5, 5])
    assert engine.matches_in_hand() == []


STOPPED = """
from fbrl.envs.matches import Matches
from fbrl.envs.engine import load_gfootball
from fbrl.collect.watchdog import Watchdog

matches = Matches("academy_empty_goal", 1, 1, ["ball"])
matches.prepare(0, 0, 2)
matches.begin([0])
matches.native.disturb(load_gfootball().engine.Disturbance("sleep", seconds=0.5))
with Watchdog(2, lambda matches: print("hangs")):
    print("begun", flush=True)
    matches.step([0], [5])
"""


def test_a_process_that_was_stopped_does_not_hang():
    process = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGSTOP)
    time.sleep(2.5)
    process.send_signal(signal.SIGCONT)
    assert process.communicate(timeout=300)[0] == ""
    assert process.returncode == 0
