"""What hangs is told from what is only slow, and from a process that stood still."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from fbrl.collect.watchdog import Watchdog
from fbrl.envs.match_threads import MatchThreads, calls_in_hand


def test_a_call_that_takes_too_long_is_named_once():
    named, seen = [], threading.Event()

    def on_hang(matches):
        named.append(list(matches))
        seen.set()

    team = MatchThreads(2, describe="match {}".format)
    with Watchdog(0.2, on_hang):
        team.map(lambda index: seen.wait(30) if index == 1 else None, range(3))
        assert seen.is_set()
        team.map(lambda index: None, range(3))
    team.close()
    assert named == [["match 1"]]


def test_many_short_calls_are_no_long_one():
    team = MatchThreads(2)
    named = []
    with Watchdog(0.2, named.append):
        for _ in range(40):
            team.map(lambda index: time.sleep(0.01), range(2))
    team.close()
    assert named == []


def test_it_can_be_turned_off():
    team = MatchThreads(1)
    with Watchdog(0, None):
        team.map(time.sleep, [0.05])
    team.close()


def test_a_call_that_fails_is_no_longer_in_hand():
    team = MatchThreads(2)
    failing = [lambda: 1 / 0] * 3
    with pytest.raises(ZeroDivisionError):
        team.map(lambda function: function(), failing)
    assert calls_in_hand() == []
    team.close()


STOPPED = """
import time
from fbrl.envs.match_threads import MatchThreads
from fbrl.collect.watchdog import Watchdog

def call(_):
    print("begun", flush=True)
    time.sleep(0.5)

with Watchdog(2, lambda matches: print("hangs")):
    MatchThreads(1).map(call, [0])
"""


def test_a_process_that_was_stopped_does_not_hang():
    process = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGSTOP)
    time.sleep(2.5)
    process.send_signal(signal.SIGCONT)
    assert process.communicate(timeout=60)[0] == ""
    assert process.returncode == 0
