"""Recorded matches: what is kept of them, and that they are what was played."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torchrl.envs import ExplorationType, exploration_type
from watching import SCENARIO, SHORT_PASS, SHOT, pass_and_shoot, random_player, recorded_matches

from fbrl.checks import UnknownNameError
from fbrl.envs.engine import FIRST_EPISODE
from fbrl.envs.matches import Matches
from fbrl.watch.pitch_view import completed_passes
from fbrl.watch.recording import RECORDED_KEYS, record_matches


def record(policy, *, episodes=1, seed=0, **options):
    settings = {"observation": "simple115", "reward": "scoring", **options}
    return list(record_matches(policy, SCENARIO, episodes=episodes, seed=seed, **settings))


def test_a_recording_holds_every_state_and_what_happened_between_them():
    match, other = recorded_matches()
    assert match.score == (1, 0)
    assert match.scenario == SCENARIO
    assert set(match.observations) == set(RECORDED_KEYS)
    assert {len(array) for array in match.observations.values()} == {match.num_steps + 1}
    assert {len(array) for array in match.rewards.values()} == {match.num_steps}
    assert match.actions[[2, -1]].tolist() == [SHORT_PASS, SHOT]
    assert match.rewards["reward_scoring"].tolist() == [0.0] * (match.num_steps - 1) + [1.0]
    assert (match.rewards["reward_end_density"] > 0).sum() == 1
    assert match.observations["steps_left"].tolist() == list(
        range(match.observations["steps_left"][0], match.observations["steps_left"][-1] - 1, -1)
    )
    assert match.engine_seed != other.engine_seed
    assert other.episode_number == match.episode_number + 1 > FIRST_EPISODE


def test_the_engine_plays_a_recording_again():
    for recording in recorded_matches():
        match = Matches(recording.scenario, 1, 1, RECORDED_KEYS)
        match.prepare(0, recording.engine_seed, recording.episode_number)
        match.begin([0])
        states = [match.observe()]
        for action in recording.actions.tolist():
            match.step([0], [action])
            states.append(match.observe())
        match.close()
        for key in RECORDED_KEYS:
            again = np.concatenate([state[key] for state in states])
            np.testing.assert_array_equal(again, recording.observations[key], err_msg=key)


def test_the_same_seed_gives_the_same_matches():
    first, again = (record(random_player, episodes=2, seed=5) for _ in range(2))
    other = record(random_player, episodes=2, seed=6)
    for one, same in zip(first, again, strict=True):
        assert one.actions.tolist() == same.actions.tolist()
        np.testing.assert_array_equal(one.observations["ball"], same.observations["ball"])
    assert first[0].actions.tolist()[:20] != first[1].actions.tolist()[:20]
    assert first[0].actions.tolist()[:20] != other[0].actions.tolist()[:20]


def test_recording_leaves_the_random_numbers_and_the_exploration_as_they_were():
    seen = set()

    def policy(state):
        seen.add((exploration_type(), torch.is_grad_enabled()))
        return random_player(state)

    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    matches = record_matches(
        policy, SCENARIO, observation="simple115", reward="scoring", episodes=2, seed=0, greedy=True
    )
    next(matches)
    assert exploration_type() != ExplorationType.DETERMINISTIC
    assert torch.is_grad_enabled()
    matches.close()
    assert torch.equal(torch.rand(3), expected)
    assert seen == {(ExplorationType.DETERMINISTIC, False)}


def test_progress_counts_matches_and_steps():
    calls = []
    matches = record(
        pass_and_shoot, episodes=2, seed=3, on_progress=lambda *progress: calls.append(progress)
    )
    lengths = [match.num_steps for match in matches]
    assert calls == [(index, 1 + n) for index in range(2) for n in range(lengths[index])]


def test_an_unknown_scenario_is_refused():
    matches = record_matches(
        random_player, "academy_4_vs_1", observation="simple115", reward="scoring", episodes=1,
        seed=0,
    )  # fmt: skip
    with pytest.raises(UnknownNameError, match="academy_4_vs_1"):
        next(matches)


def with_owners(owners, game_mode=None):
    """A recording in which these players, as (team, player), have the ball, at x = index / 10."""
    match = recorded_matches()[0]
    count = len(owners)
    observations = {key: array[:count] for key, array in match.observations.items()}
    observations["ball_owned_team"], observations["ball_owned_player"] = np.array(owners).T
    observations["game_mode"] = np.zeros(count, int) if game_mode is None else np.array(game_mode)
    observations["ball"] = np.arange(count)[:, None] / 10 * [1, 0, 0]
    return dataclasses.replace(match, observations=observations, actions=match.actions[1:count])


NOBODY = (-1, -1)


@pytest.mark.parametrize(
    ("owners", "game_mode", "expected"),
    [
        ([(0, 1), (0, 1), NOBODY, (0, 2), (0, 2)], None, [(0, 3, 0.1, 0.3)]),
        ([(0, 1), (0, 2), (0, 1)], None, [(0, 1, 0.0, 0.1), (0, 2, 0.1, 0.2)]),
        ([(0, 1), NOBODY, (0, 1)], None, []),
        ([(0, 1), (1, 2), (0, 2)], None, []),
        ([(1, 1), NOBODY, (1, 4)], None, [(1, 2, 0.0, 0.2)]),
        ([(0, 1), NOBODY, (0, 2)], [0, 5, 0], []),
    ],
    ids=["pass", "one-two", "dribble", "lost and won", "opponents", "throw-in"],
)
def test_passes_go_between_players_of_a_team_in_play(owners, game_mode, expected):
    passes = completed_passes(with_owners(owners, game_mode))
    found = [(p.team, p.received_at, p.start[0], p.end[0]) for p in passes]
    assert len(found) == len(expected)
    for one, wanted in zip(found, expected, strict=True):
        assert one == pytest.approx(wanted)
