"""A match that goes on from a stored state."""

from __future__ import annotations

import numpy as np
import pytest

from fbrl.envs.engine import BUILTIN_AI, ROW_LENGTH, Match

SCENARIOS = ["academy_3_vs_1_with_keeper", "academy_counterattack_hard", "11_vs_11_stochastic"]


def play(match, actions):
    """Rows and results of the steps until the episode ends."""
    steps = []
    for action in actions:
        result = match.step(int(action))
        row = np.zeros(ROW_LENGTH)
        match.read(row)
        steps.append((row.tolist(), result))
        if result.terminated or result.truncated:
            break
    return steps


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_restored_match_goes_on_exactly_as_it_did(scenario):
    actions = np.random.default_rng(5).integers(0, BUILTIN_AI, 120, endpoint=True)
    match = Match(scenario)
    match.reset(seed=3)
    play(match, [5, 5, 11, 0, 9])
    state = match.get_state()
    expected = play(match, actions)
    assert len(expected) > 10

    # Other seeds and numbers process the teams in another order and let the other one kick off.
    for seed, episode_number in [(99, 2), (98, 2), (98, 3)]:
        match.reset(seed, episode_number)
        play(match, [3] * 5)
        match.set_state(state)
        assert play(match, actions) == expected

    other = Match(scenario)
    other.set_state(state)
    assert play(other, actions) == expected
    match.close()
    other.close()


def test_a_state_holds_the_count_of_waiting_steps():
    match = Match("11_vs_11_easy_stochastic")
    match.reset(seed=6)
    # Running the ball out and standing still: the game waits, until the rule forces a pass.
    while match.get_state().waiting_steps < 12:
        play(match, [7])
    state = match.get_state()
    expected = play(match, [0] * 30)
    match.reset(seed=2)
    match.set_state(state)
    assert match.get_state().waiting_steps == 12
    assert play(match, [0] * 30) == expected
    match.close()


def test_only_a_running_match_has_a_state():
    match = Match("academy_empty_goal_close")
    with pytest.raises(RuntimeError, match=r"call reset\(\) before"):
        match.get_state()
    match.reset(seed=0)
    state = match.get_state()
    match.close()
    with pytest.raises(RuntimeError, match="is closed"):
        match.set_state(state)


def test_the_built_in_player_wins_where_standing_still_does_not():
    match = Match("academy_empty_goal_close")
    goals = {}
    for action in (0, BUILTIN_AI):
        match.reset(seed=4)
        goals[action] = sum(result.reward for _, result in play(match, [action] * 401))
    match.close()
    assert goals == {0: 0, BUILTIN_AI: 1}
