"""Matches in worker processes: those of the threads, and what happens when a worker dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import needs_engine

from fbrl.envs import FootballVectorEnv
from fbrl.envs.match_worker import MatchWorker
from fbrl.envs.process_vector_env import FootballProcessVectorEnv, MatchWorkersError

SCENARIO = "academy_3_vs_1_with_keeper"
KEYS = ("ball", "left_team", "active", "game_mode")


@pytest.fixture
def make():
    made = []

    def make_processes(num_envs=3, **options):
        made.append(FootballProcessVectorEnv(SCENARIO, num_envs, None, KEYS, **options))
        return made[-1]

    yield make_processes
    for env in made:
        env.close()


def assert_same(observation, expected):
    assert observation.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_array_equal(observation[key], value)
        assert observation[key].dtype == value.dtype


def play(env, random, steps):
    """Steps with resets, as a collector does; yields what each call returned."""
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(random.integers(19, size=3))
        yield observation, reward, terminated, truncated
        ended = terminated | truncated
        if ended.any():
            observation, info = env.reset(options={"reset_mask": ended})
            yield observation, info["engine_seed"]


def test_processes_play_the_matches_of_the_threads_and_exchange_states_with_them(make):
    processes, threads = make(), FootballVectorEnv(SCENARIO, 3, 1, KEYS)
    for env in (processes, threads):
        env.first = env.reset(seed=4)
    assert_same(processes.first[0], threads.first[0])
    both = zip(
        play(processes, np.random.default_rng(0), 150),
        play(threads, np.random.default_rng(0), 150),
        strict=True,
    )
    resets = 0
    for ours, theirs in both:
        assert_same(ours[0], theirs[0])
        for one, other in zip(ours[1:], theirs[1:], strict=True):
            np.testing.assert_array_equal(one, other)
        resets += len(ours) == 2
    assert resets >= 2
    assert processes.episodes == threads.episodes

    state = processes.get_state()
    actions = [np.array([5, 12, 0])] * 10
    expected = [processes.step(action)[0] for action in actions]
    threads.set_state(state)
    for action, observation in zip(actions, expected, strict=True):
        assert_same(threads.step(action)[0], observation)
    processes.set_state(state)
    assert_same(processes.step(actions[0])[0], expected[0])
    threads.close()


@pytest.mark.parametrize("sign", [signal.SIGABRT, signal.SIGSTOP])
def test_a_worker_that_aborts_or_hangs_is_replaced_and_its_matches_are_cut_off(make, sign):
    lines = []
    env = make(timeout=2, on_restart=lines.append)
    before, _ = env.reset(seed=1)
    idle = np.zeros(3, int)
    before = env.step(idle)[0]
    victim = env._workers[0].process
    os.kill(victim.pid, sign)
    started = time.monotonic()
    observation, reward, terminated, truncated, _ = env.step(idle)
    assert time.monotonic() - started < 60
    lost = [0, 1]
    assert truncated.tolist() == [True, True, False]
    assert not terminated.any()
    assert reward[lost].tolist() == [0, 0]
    for key in KEYS:
        np.testing.assert_array_equal(observation[key][lost], before[key][lost])
    assert env.lost_matches == 2
    reason = "SIGABRT" if sign == signal.SIGABRT else "has not answered for 2 s"
    assert len(lines) == 1
    assert reason in lines[0]
    assert "2 matches have been lost" in lines[0]
    assert not victim.is_alive()

    env.reset(options={"reset_mask": truncated})
    assert not env.step(idle)[3].any(), "the new matches are played like any others"


def test_a_worker_that_died_between_two_steps_is_told_by_the_next_one(make):
    env = make()
    env.reset(seed=1)
    before = env.step(np.zeros(3, int))[0]
    os.kill(env._workers[1].process.pid, signal.SIGKILL)
    assert len(env.get_state()) == 3
    observation, _, _, truncated, _ = env.step(np.zeros(3, int))
    assert truncated.tolist() == [False, False, True]
    np.testing.assert_array_equal(observation["ball"][2], before["ball"][2])
    env.reset(options={"reset_mask": truncated})
    assert not env.step(np.zeros(3, int))[3].any()


def kill(worker):
    worker.process.kill()
    worker.process.join()


def test_a_replacement_that_dies_at_once_is_replaced_too(make, monkeypatch):
    env = make()
    env.reset(seed=1)
    env.step(np.zeros(3, int))
    ask, to_kill = MatchWorker.ask, [1, 2, 3]

    def ask_a_dying_worker(worker, method, arguments):
        if worker.process.name == "matches-1" and to_kill:
            to_kill.pop()
            kill(worker)
        ask(worker, method, arguments)

    monkeypatch.setattr(MatchWorker, "ask", ask_a_dying_worker)
    assert len(env.get_state()) == 3
    assert env.lost_matches == 3
    assert env.step(np.zeros(3, int))[3].tolist() == [False, False, True]


def test_a_worker_lost_in_a_partial_reset_ends_its_other_matches_as_they_were_seen(make):
    env = make()
    env.reset(seed=1)
    for _ in range(5):
        before = env.step(np.array([5, 5, 5]))[0]
    kill(env._workers[0])
    observation, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    for key in KEYS:
        np.testing.assert_array_equal(observation[key][0], before[key][0])
    after, _, _, truncated, _ = env.step(np.zeros(3, int))
    assert truncated.tolist() == [True, True, False]
    np.testing.assert_array_equal(after["ball"][0], before["ball"][0])


def test_matches_put_back_by_a_replacement_go_on(make):
    env = make()
    env.reset(seed=1)
    env.step(np.zeros(3, int))
    state = env.get_state()
    expected = env.step(np.array([5, 12, 0]))[0]
    kill(env._workers[0])
    env.set_state(state)
    assert env.lost_matches == 2
    observation, _, _, truncated, _ = env.step(np.array([5, 12, 0]))
    assert not truncated.any()
    assert_same(observation, expected)


def test_the_matches_after_lost_ones_follow_from_the_seed_whatever_its_type(make):
    episodes = []
    for seed in (7, np.int64(7)):
        env = make()
        env.reset(seed=seed)
        kill(env._workers[0])
        env.get_state()
        episodes.append(env.episodes)
    assert episodes[0] == episodes[1]


def test_no_signal_to_the_whole_group_ends_a_worker_even_as_it_starts(make, monkeypatch):
    start = FootballProcessVectorEnv._start

    def start_and_signal(env, number, seeds):
        worker = start(env, number, seeds)
        signal_all(worker)
        return worker

    def signal_all(worker):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
            os.kill(worker.process.pid, number)

    monkeypatch.setattr(FootballProcessVectorEnv, "_start", start_and_signal)
    env = make()
    env.reset(seed=1)
    for worker in env._workers:
        signal_all(worker)
    assert not env.step(np.zeros(3, int))[3].any()
    assert env.lost_matches == 0


NOT_CLOSED = """
if __name__ == "__main__":
    from fbrl.envs.process_vector_env import FootballProcessVectorEnv
    env = FootballProcessVectorEnv("academy_empty_goal", 2)
    env.reset(seed=1)
"""


@needs_engine
def test_a_program_that_closes_nothing_ends_all_the_same(tmp_path):
    (tmp_path / "program.py").write_text(NOT_CLOSED)
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


def misuse(env):
    """What errors say, and what is observed after them."""
    messages = []

    def expect(kind, call, *arguments):
        with pytest.raises(kind) as raised:
            call(*arguments)
        messages.append(str(raised.value))

    env.reset(seed=4)
    state = env.get_state()
    # Matches 0 and 2, of two workers, shoot; one of them ends first.
    ended = np.zeros(3, bool)
    while not ended.any():
        _, _, terminated, truncated, _ = env.step(np.array([12, 0, 12]))
        ended = terminated | truncated
    expect(RuntimeError, env.step, np.zeros(3, int))
    expect(RuntimeError, env.get_state)
    env.reset(options={"reset_mask": ended})
    expect(ValueError, env.set_state, [*state[:2], {}])
    expect(ValueError, env.set_state, [{}, *state[1:]])
    expect(ValueError, env.step, np.array([0, 0, 19]))
    env.set_state(state)
    return messages, [env.step(np.array([5, 12, 0]))[0] for _ in range(3)], ended


def test_misuse_is_told_as_by_the_threads_and_both_can_be_used_further(make):
    threads = FootballVectorEnv(SCENARIO, 3, 1, KEYS)
    messages, observations, ended = misuse(threads)
    threads.close()
    ours, played, _ = misuse(make())
    assert ours == messages
    assert messages[0].startswith(f"Matches {np.flatnonzero(ended).tolist()} of ")
    assert messages[2].startswith("State 2 is not that of a match")
    for one, other in zip(played, observations, strict=True):
        assert_same(one, other)


def test_workers_that_cannot_begin_are_an_error_at_once(make, monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    env = make()
    with pytest.raises(MatchWorkersError, match=r"exit code 1 before they began.*fbrl-doctor"):
        env.reset()


def test_workers_that_die_too_often_are_an_error(make):
    env = make(max_restarts=0)
    env.reset(seed=1)
    os.kill(env._workers[0].process.pid, signal.SIGKILL)
    with pytest.raises(MatchWorkersError, match=r"SIGKILL; 2 matches have been lost.*too often"):
        env.step(np.zeros(3, int))
    with pytest.raises(RuntimeError, match="broken off"):
        env.step(np.zeros(3, int))


def test_misuse_is_named(make):
    env = make()
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step"):
        env.step(np.zeros(3, int))
    env.reset(seed=1)
    with pytest.raises(ValueError, match="not all in"):
        env.step(np.array([0, 0, 19]))
    with pytest.raises(ValueError, match="states of 1 matches for 3"):
        env.set_state(env.get_state()[:1])
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()
    for name in ("num_workers", "num_threads"):
        with pytest.raises(ValueError, match=f"{name} is 0"):
            FootballProcessVectorEnv(SCENARIO, **{name: 0})
