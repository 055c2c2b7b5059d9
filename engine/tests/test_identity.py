"""Our engine plays the matches of gfootball as pip builds it, bit for bit."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path

import pytest
from ci_episodes import episodes
from comparison import Table, first_differing_step
from engine_process import EnginePlayError, play
from engines import (
    WITHOUT_FMA,
    differences,
    engine_directory,
    play_in_processes,
    recorded,
    reference_records,
)
from episodes import BRUTAL, STYLES
from million import Shard
from observation import bits


@pytest.fixture(scope="module")
def ours():
    return play_in_processes(engine_directory(), episodes())


def test_all_that_is_seen_is_what_pips_engine_shows(ours):
    assert differences(episodes(), ours, reference_records()) == []


def test_that_is_20_000_steps_of_all_scenarios_and_styles_and_of_what_is_rare(ours):
    assert sum(record["steps"] for record in ours) >= 20_000
    assert len({episode.scenario for episode in episodes()}) == 19 + 1
    assert {episode.style for episode in episodes()} == {*STYLES, BRUTAL}
    assert len({(episode.seed % 2, episode.number % 2) for episode in episodes()}) == 4
    events = sum((Counter(record["events"]) for record in ours), Counter())
    assert all(events[name] for name in ("penalties", "sent_off", "offsides", "half_times"))
    assert {record["end"] for record in ours} == {
        *("left", "time_limit", "score", "out_of_play", "possession")
    }


def test_matches_replay_from_their_states(ours):
    replays = [record["replays"] for record in ours]
    assert sum(number for number, _ in replays) > 90
    assert all(number == equal for number, equal in replays)


def test_matches_are_those_of_pips_engine_without_fused_multiplication_too():
    some = episodes()[:40]
    lines = list(play(engine_directory(), [], environment=WITHOUT_FMA))
    expected = recorded(lines[0]["libm"])
    if expected is None:
        pytest.skip("this machine's glibc is another one than pip's engine was recorded with")
    ours = play_in_processes(engine_directory(), some, WITHOUT_FMA)
    assert differences(some, ours, expected[: len(some)]) == []


def test_another_match_shows(ours):
    others = [ours[1], *ours[1:]]
    assert len(differences(episodes(), ours, others)) == 1


# Our engine, but once, at the 40th step, the least bit of the ball's momentum is another one.
FLIPPED = """
import sys
sys.path.append({tests!r})
from fbrl_engine import DATA, _native
from fbrl_engine._native import *
from state_layout import fields

class GameEnv(_native.GameEnv):
    def __init__(self):
        super().__init__(str(DATA))
        self.steps = 0

    def step(self):
        super().step()
        self.steps += 1
        if self.steps == 40:
            state = bytearray(self.get_state(""))
            momentum = next(field for field in fields(state) if field.name == "ball.momentum")
            state[momentum.start] ^= {bit}
            self.set_state(bytes(state))
"""


@pytest.mark.parametrize("bit", [0, 1])
def test_one_bit_of_an_engine_shows_and_where(tmp_path, bit):
    package = tmp_path / "gfootball_engine"
    package.mkdir()
    tests = str(Path(__file__).parent)
    (package / "__init__.py").write_text(FLIPPED.format(tests=tests, bit=bit))
    engine = engine_directory()
    flipped = Path(f"{tmp_path}:{engine}" if engine else tmp_path)
    shard = Shard("some", "academy_3_vs_1_with_keeper", 1, ("mixed",), 7, 2, 0)
    sides = [
        [line for line in play(side, shard.episodes(), "--episodes", "1") if "scenario" in line]
        for side in (engine, flipped)
    ]
    table = Table()
    table.add(shard, *sides)
    assert len(table.differences) == bit
    if bit:
        (difference,) = table.differences
        assert "observed" in difference.keys
        told = first_differing_step(difference, engine, flipped)
        # The steps before the game is in play are none of the episode's.
        assert re.match(r"step 1\d: .*ball", told), told


def test_a_bit_shows():
    number = 0.123
    for other in (math.nextafter(number, 1), -number):
        assert bits({"ball": [number]}) != bits({"ball": [other]})
    assert bits({"ball": [0.0]}) != bits({"ball": [-0.0]})


def test_an_engine_that_is_missing_is_told(tmp_path):
    (tmp_path / "gfootball").mkdir()
    (tmp_path / "gfootball_engine.py").write_text("raise ImportError('no engine here')")
    with pytest.raises(EnginePlayError, match="no engine here"):
        list(play(Path(tmp_path), episodes()[:1]))
