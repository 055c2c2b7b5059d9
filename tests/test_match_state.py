"""A match that goes on from a stored state."""

from __future__ import annotations

import numpy as np
import pytest

from fbrl.envs import OBSERVATION_SPACE
from fbrl.envs.engine import BUILTIN_AI, FIRST_EPISODE
from fbrl.envs.matches import Matches

SCENARIOS = ["academy_3_vs_1_with_keeper", "academy_counterattack_hard", "11_vs_11_stochastic"]


class Match(Matches):
    """One match alone."""

    def __init__(self, scenario):
        super().__init__(scenario, 1, 1, OBSERVATION_SPACE)

    def reset(self, seed, episode_number=FIRST_EPISODE):
        self.prepare(0, seed, episode_number)
        self.begin([0])

    def play(self, actions):
        """What the steps led to, until the episode ends."""
        steps = []
        for action in actions:
            self.step([0], [int(action)])
            steps.append({key: array[0].tolist() for key, array in self.arrays.items()})
            if self.not_running():
                break
        return steps


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_restored_match_goes_on_exactly_as_it_did(scenario):
    actions = np.random.default_rng(5).integers(0, BUILTIN_AI, 120, endpoint=True)
    match = Match(scenario)
    match.reset(seed=3)
    match.play([5, 5, 11, 0, 9])
    state = match.get_state(0)
    expected = match.play(actions)
    assert len(expected) > 10

    # Other seeds and numbers process the teams in another order and let the other one kick off.
    for seed, episode_number in [(99, 2), (98, 2), (98, 3)]:
        match.reset(seed, episode_number)
        match.play([3] * 5)
        match.set_state(0, state)
        assert match.play(actions) == expected

    other = Match(scenario)
    other.set_state(0, state)
    assert other.play(actions) == expected
    match.close()
    other.close()


def test_a_state_holds_the_count_of_waiting_steps():
    match = Match("11_vs_11_easy_stochastic")
    match.reset(seed=6)
    # Running the ball out and standing still: the game waits, until the rule forces a pass.
    while match.get_state(0).waiting_steps < 12:
        match.play([7])
    state = match.get_state(0)
    expected = match.play([0] * 30)
    match.reset(seed=2)
    match.set_state(0, state)
    assert match.get_state(0).waiting_steps == 12
    assert match.play([0] * 30) == expected
    match.close()


def test_only_a_running_match_has_a_state():
    match = Match("academy_empty_goal_close")
    with pytest.raises(RuntimeError, match="is not running"):
        match.get_state(0)
    match.reset(seed=0)
    state = match.get_state(0)
    match.close()
    with pytest.raises(RuntimeError, match="are closed"):
        match.set_state(0, state)


def test_the_built_in_player_wins_where_standing_still_does_not():
    match = Match("academy_empty_goal_close")
    goals = {}
    for action in (0, BUILTIN_AI):
        match.reset(seed=4)
        goals[action] = sum(step["reward"] for step in match.play([action] * 401))
    match.close()
    assert goals == {0: 0, BUILTIN_AI: 1}
