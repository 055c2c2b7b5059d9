"""Rows hold what the wanted keys need, and nothing depends on which other keys are wanted."""

from __future__ import annotations

import numpy as np
import pytest

from fbrl.envs import OBSERVATION_SPACE
from fbrl.envs.engine import Match
from fbrl.envs.match_row import FIELDS, WHOLE_ROW, RowLayout


@pytest.fixture(scope="module")
def match():
    """3 against 1 after some steps, so that 15 of 22 players are missing and someone has run."""
    match = Match("academy_3_vs_1_with_keeper")
    match.reset(seed=4)
    for _ in range(8):
        match.step(5)
    yield match
    match.close()


def read(match, keys):
    layout = RowLayout(keys)
    row = layout.rows(1)[0]
    match.read(row, layout)
    return layout.split(row)


@pytest.mark.parametrize("key", list(FIELDS))
def test_a_key_alone_reads_as_among_all_others(match, key):
    everything = read(match, FIELDS)
    (alone,) = read(match, [key]).values()
    assert alone.dtype == everything[key].dtype == OBSERVATION_SPACE[key].dtype
    assert alone.shape == OBSERVATION_SPACE[key].shape
    np.testing.assert_array_equal(alone, everything[key])


def test_a_row_is_as_long_as_its_keys_are_large():
    keys = ["ball", "left_team", "sticky_actions", "game_mode"]
    assert RowLayout(keys).length == 3 + 22 + 10 + 1
    sizes = [int(np.prod(space.shape)) for space in OBSERVATION_SPACE.values()]
    assert WHOLE_ROW.length == sum(sizes)


def test_numbers_of_an_earlier_match_with_more_players_do_not_stay():
    layout = RowLayout(["right_team", "right_team_active", "right_team_roles"])
    row = layout.rows(1)[0]
    row[:] = 7
    match = Match("academy_empty_goal_close")
    match.reset(seed=0)
    match.read(row, layout)
    match.close()
    arrays = layout.split(row)
    assert (arrays["right_team"][1:] == -1).all()
    assert (arrays["right_team_roles"][1:] == -1).all()
    assert (arrays["right_team_active"][1:] == 0).all()
    assert arrays["right_team_roles"][0] == 0


def test_arrays_are_split_for_any_number_of_matches_and_not_written_over(match):
    layout = RowLayout(["ball", "score", "steps_left"])
    rows = layout.rows(3)
    for row in rows:
        match.read(row, layout)
    arrays = layout.split(rows)
    assert {key: array.shape for key, array in arrays.items()} == {
        "ball": (3, 3),
        "score": (3, 2),
        "steps_left": (3,),
    }
    ball = arrays["ball"].copy()
    rows[:] = 0
    np.testing.assert_array_equal(arrays["ball"], ball)
