"""States of one engine serve the other, and threads play as one does."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from ci_episodes import episodes, saved_episodes
from engine_process import engine_environment, play
from engines import (
    differences,
    engine_directory,
    play_in_processes,
    reference_directory,
)
from small_pitch import SMALL_PITCH
from state_layout import differing_fields, fields, hide_uninitialised

CROSS_STATES = Path(__file__).with_name("cross_states.py")


def cross(way: str, engine: Path | None, folder: Path) -> list[dict[str, object]]:
    folder.mkdir(exist_ok=True)
    process = subprocess.run(
        [sys.executable, CROSS_STATES, way, folder],
        env=engine_environment(engine),
        input="".join(json.dumps(asdict(episode)) + "\n" for episode in saved_episodes()),
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return [json.loads(line) for line in process.stdout.splitlines()][1:]


@pytest.fixture(scope="module")
def saved_by_ours(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ours")
    return folder, cross("save", engine_directory(), folder)


def test_a_state_of_either_engine_goes_on_equally_in_both(saved_by_ours, tmp_path):
    reference = reference_directory()
    if reference is None:
        pytest.skip("asks for pip's engine: `scripts/setup.sh --default-engine`")
    folder, ours = saved_by_ours
    assert cross("save", reference, tmp_path) == ours
    assert cross("restore", engine_directory(), tmp_path) == ours
    assert cross("restore", reference, folder) == ours
    for path in sorted(folder.glob("*.state")):
        other = (tmp_path / path.name).read_bytes()
        assert differing_fields(path.read_bytes(), other) == [], path.name


def test_a_state_goes_on_equally_in_another_process(saved_by_ours):
    folder, ours = saved_by_ours
    assert cross("restore", engine_directory(), folder) == ours


def test_a_flipped_bit_of_a_state_shows_by_the_name_of_its_field(saved_by_ours):
    folder, _ = saved_by_ours
    state = (folder / "000.state").read_bytes()
    filled = [field for field in fields(state) if field.stop > field.start]
    for field in filled[:: len(filled) // 50]:
        other = bytearray(state)
        other[field.start] ^= 1
        assert differing_fields(state, bytes(other)) == [field.name]


def test_only_the_padding_of_angles_is_left_out(saved_by_ours):
    folder, _ = saved_by_ours
    state = (folder / "000.state").read_bytes()
    shown = bytearray(hide_uninitialised(state))
    for field in fields(state):
        if field.kind == "r":
            shown[field.start + 5 : field.stop] = state[field.start + 5 : field.stop]
    assert bytes(shown) == state


def test_memory_that_was_never_set_decides_nothing():
    """Malloc fills it with something else."""
    some = [episode for episode in episodes() if episode.states_every][:8]
    plain = play_in_processes(engine_directory(), some)
    filled = play_in_processes(engine_directory(), some, {"MALLOC_PERTURB_": "165"})
    assert differences(some, plain, filled) == []


def test_threads_play_as_one_does():
    some = [
        episode
        for episode in episodes()
        if episode.scenario in (SMALL_PITCH, "academy_corner") and not episode.states_every
    ][-6:]
    serial = [line for line in play(engine_directory(), some) if "scenario" in line]
    lines = play(engine_directory(), some, "--threads", "3")
    assert differences(some, serial, [line for line in lines if "scenario" in line]) == []
