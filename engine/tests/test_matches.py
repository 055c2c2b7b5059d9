"""Matches that C++ threads play are those that Python steps."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from ci_episodes import episodes
from engine_process import engine_environment, play
from engines import engine_directory

PLAY_NATIVE = Path(__file__).with_name("play_native.py")
# Different ends; whole matches are short in none of the others.
SCENARIOS = ("academy_3_vs_1_with_keeper", "academy_corner", "test_example_multiagent")


def natively(wanted, threads):
    process = subprocess.run(
        [sys.executable, PLAY_NATIVE, "--threads", str(threads)],
        env=engine_environment(engine_directory()),
        input="".join(json.dumps(asdict(episode)) + "\n" for episode in wanted),
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    lines = [json.loads(line) for line in process.stdout.splitlines()]
    return [line for line in lines if "scenario" in line]


def by_seed(records):
    keys = ("steps", "observed", "end")
    return {(r["seed"], r["number"]): [r[key] for key in keys] for r in records}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_they_show_the_same_with_any_number_of_threads(scenario):
    wanted = [
        # To their ends, which the native ones can't be kept from.
        replace(episode, limit=10_000, states_every=0)
        for episode in episodes()
        if episode.scenario == scenario and episode.left_agents == 1
    ][:7]
    stepped = by_seed(line for line in play(engine_directory(), wanted) if "scenario" in line)
    assert len(stepped) == len(wanted) >= 5
    for threads in (1, 2, 4):
        assert by_seed(natively(wanted, threads)) == stepped, f"{threads} threads"
