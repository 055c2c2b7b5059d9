"""Native matches: what they write, how work is sent and waited for, and what becomes of faults."""

from __future__ import annotations

import gc
import signal
import threading
import weakref

import numpy as np
import pytest
from torchrl.envs import GymEnv

from fbrl.envs import OBSERVATION_SPACE, make_env
from fbrl.envs.engine import FIRST_EPISODE, build_scenario, load_gfootball
from fbrl.envs.matches import Matches

SCENARIO = "academy_3_vs_1_with_keeper"


def begin(keys=OBSERVATION_SPACE, num_matches=1, num_threads=1, scenario=SCENARIO):
    matches = Matches(scenario, num_matches, num_threads, keys)
    for match in range(num_matches):
        matches.prepare(match, 4 + match, FIRST_EPISODE)
    matches.begin(range(num_matches))
    return matches


@pytest.fixture
def matches():
    matches = begin(num_matches=3, num_threads=2)
    yield matches
    matches.close()


@pytest.fixture(scope="module")
def everything():
    """Every key of a match after some steps, in which 15 of 22 players are missing."""
    matches = begin()
    for _ in range(8):
        matches.step([0], [5])
    observed = matches.observe()
    matches.close()
    return observed


def test_the_engine_knows_the_keys_by_the_shapes_and_dtypes_of_the_space():
    fields = load_gfootball().engine.FIELDS
    for key, space in OBSERVATION_SPACE.items():
        assert fields[key] == (space.shape, space.dtype.name)
    assert set(fields) - set(OBSERVATION_SPACE) == {"reward", "terminated", "truncated"}


@pytest.mark.parametrize("key", list(OBSERVATION_SPACE))
def test_a_key_alone_reads_as_among_all_others(everything, key):
    matches = begin([key])
    for _ in range(8):
        matches.step([0], [5])
    (alone,) = matches.observe().values()
    matches.close()
    np.testing.assert_array_equal(alone, everything[key])


def test_numbers_of_an_earlier_match_with_more_players_do_not_stay():
    matches = Matches("academy_empty_goal_close", 1, 1, OBSERVATION_SPACE)
    for array in matches.arrays.values():
        array[...] = 7
    matches.prepare(0, 0, FIRST_EPISODE)
    matches.begin([0])
    arrays = {key: array[0] for key, array in matches.observe().items()}
    matches.close()
    assert (arrays["right_team"][1:] == -1).all()
    assert (arrays["right_team_roles"][1:] == -1).all()
    assert (arrays["right_team_active"][1:] == 0).all()
    assert arrays["right_team_roles"][0] == 0


def test_rows_may_lie_apart_in_a_batch_of_many_steps():
    engine = load_gfootball().engine
    matches = begin(["ball"], num_matches=2)
    batch = np.zeros((2, 5, 3), np.float32)
    for step in range(5):
        rows = engine.Rows({"ball": batch[:, step]})
        matches.native.send_step([0, 1], [5, 3], rows).wait()
        matches_now = batch[:, step].copy()
        assert matches_now.any()
    assert (np.diff(batch[:, :, 0], axis=1) != 0).any()
    np.testing.assert_array_equal(batch[:, 4], matches_now)
    matches.close()


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((1, 3), np.float64),
        np.zeros((1, 4), np.float32),
        np.zeros(3, np.float32),
        np.zeros((1, 6), np.float32)[:, ::2],
    ],
)
def test_an_array_that_does_not_fit_is_refused(array):
    with pytest.raises(ValueError, match=r"array for ball must be of float32 .*\(matches, 3\)"):
        load_gfootball().engine.Rows({"ball": array})


def test_an_unknown_field_is_refused():
    with pytest.raises(KeyError, match="no field balls of a match"):
        load_gfootball().engine.Rows({"balls": np.zeros((1, 3), np.float32)})


def test_some_matches_are_stepped_while_others_are_waited_for(matches):
    alone = begin(num_matches=3)
    native, rows = matches.native, matches._rows
    for _ in range(6):
        first = native.send_step([0, 2], [5, 5], rows)
        second = native.send_step([1], [3], rows)
        second.wait()
        first.wait()
        alone.step([0, 1, 2], [5, 3, 5])
    for key, array in alone.arrays.items():
        np.testing.assert_array_equal(matches.arrays[key], array)
    alone.close()


def test_a_match_that_is_being_played_takes_no_other_work(matches):
    load = load_gfootball().engine
    matches.native.disturb(load.Disturbance("sleep", seconds=0.2))
    batch = matches.native.send_step([0], [5], matches._rows)
    with pytest.raises(RuntimeError, match="Match 0 is still being played"):
        matches.step([0, 1], [5, 5])
    batch.wait()
    matches.step([0, 1], [5, 5])


def test_a_match_that_ended_has_begun_its_next_episode_already():
    matches = begin(scenario="academy_empty_goal_close")
    matches.prepare(0, 77, FIRST_EPISODE + 1)
    while not matches.not_running():
        matches.step([0], [5])
    assert matches.arrays["terminated"][0] or matches.arrays["truncated"][0]
    matches.begin([0])
    assert matches.episodes == [(77, FIRST_EPISODE + 1)]
    other = Matches("academy_empty_goal_close", 1, 1, OBSERVATION_SPACE)
    other.prepare(0, 77, FIRST_EPISODE + 1)
    other.begin([0])
    for key, array in other.observe().items():
        np.testing.assert_array_equal(matches.arrays[key], array)
    matches.close()
    other.close()


def test_a_match_that_fails_is_named_and_the_others_go_on(matches):
    engine = load_gfootball().engine
    matches.native.disturb(engine.Disturbance("throw", engine_seed=5))
    with pytest.raises(
        RuntimeError,
        match=r"match 1 of academy_3_vs_1_with_keeper \(engine seed 5, episode 2\) fail",
    ):
        matches.step([0, 1, 2], [5, 5, 5])
    assert matches.not_running() == [1]
    matches.native.disturb(None)
    matches.step([0, 2], [5, 5])
    matches.prepare(1, 9, FIRST_EPISODE)
    matches.begin([1])
    matches.step([0, 1, 2], [5, 5, 5])


def test_a_hang_is_interrupted_and_named_and_keeps_nobody(matches):
    engine = load_gfootball().engine
    matches.native.disturb(engine.Disturbance("hang", engine_seed=6))
    timer = threading.Timer(0.5, signal.raise_signal, [signal.SIGINT])
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        matches.step([0, 1, 2], [5, 5, 5])
    timer.join()
    hanging = [match for _, match in engine.matches_in_hand()]
    assert hanging == ["match 2 of academy_3_vs_1_with_keeper (engine seed 6, episode 2)"]


@pytest.mark.parametrize("players", [0, 12])
def test_a_team_that_the_engine_cannot_play_is_refused(players):
    engine = load_gfootball().engine
    native = engine.Matches("mine", 1, 1)
    config = build_scenario(SCENARIO, 1, FIRST_EPISODE)
    player = config.left_team[0]
    config.left_team.clear()
    for _ in range(players):
        config.left_team.append(player)
    with pytest.raises(ValueError, match=f"mine has {players} players; the engine plays 1 to 11"):
        native.prepare(0, config, 1, FIRST_EPISODE)


def test_matches_that_are_closed_say_so(matches):
    matches.close()
    with pytest.raises(RuntimeError, match="are closed: make new ones"):
        matches.step([0], [5])


@pytest.mark.parametrize("num_threads", [1, 4])
def test_threads_do_not_change_what_is_played(num_threads):
    serial, parallel = begin(num_matches=6), begin(num_matches=6, num_threads=num_threads)
    random = np.random.default_rng(3)
    for _ in range(30):
        running = sorted(set(range(6)) - set(serial.not_running()))
        actions = random.integers(0, 19, len(running)).tolist()
        serial.step(running, actions)
        parallel.step(running, actions)
        for key, array in serial.arrays.items():
            np.testing.assert_array_equal(parallel.arrays[key], array)
    serial.close()
    parallel.close()


@pytest.mark.parametrize(
    "make",
    [
        lambda: make_env("academy_empty_goal", num_envs=2, seed=0),
        lambda: GymEnv("fbrl/academy_empty_goal-v0"),
    ],
    ids=["make_env", "GymEnv"],
)
def test_environments_that_are_dropped_without_close_hand_their_engines_on(make):
    gc.collect()
    gc.disable()  # as if Python did not look for cycles in all that time
    try:
        dropped = []
        for _ in range(4):
            env = make()
            env.rollout(3)
            dropped.append(weakref.ref(env))
        assert sum(one() is not None for one in dropped) <= 2
    finally:
        gc.enable()
