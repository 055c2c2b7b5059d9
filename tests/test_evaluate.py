"""Evaluation: which matches count, the interval, and repeatability."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchrl.modules.tensordict_module.exploration import RandomPolicy

from fbrl.envs import make_env
from fbrl.evaluation.evaluation import Evaluation, evaluate, play_matches
from fbrl.evaluation.policies import make_policy
from fbrl.models.actor_critic import build_actor_critic

SCENARIO = "academy_3_vs_1_with_keeper"


def test_the_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        goals = rng.choice([-1, 0, 1], p=[0.1, 0.6, 0.3], size=100)
        low, high = Evaluation({"goal_difference": goals}).interval
        covered += low <= 0.2 <= high
    assert 180 <= covered <= 199


def test_the_interval_is_that_of_the_normal_approximation_where_that_holds():
    goals = np.repeat([0.0, 1.0], [120, 280])
    evaluation = Evaluation({"goal_difference": goals})
    low, high = evaluation.interval
    error = 1.96 * goals.std(ddof=1) / 20
    assert evaluation.goal_difference == pytest.approx(0.7)
    assert low == pytest.approx(0.7 - error, abs=0.005)
    assert high == pytest.approx(0.7 + error, abs=0.005)
    assert evaluation.interval == (low, high)
    assert str(evaluation) == f"0.700 [{low:.3f}, {high:.3f}] over 400 matches"


def test_equal_results_have_an_interval_of_no_width():
    assert Evaluation({"goal_difference": np.ones(10)}).interval == (1.0, 1.0)


def test_matches_without_a_figure_are_left_out_of_its_mean():
    evaluation = Evaluation({"possession_share": np.array([0.25, np.nan, 0.75])})
    assert evaluation.mean("possession_share") == 0.5
    low, high = evaluation.mean_interval("possession_share")
    assert 0.25 <= low < 0.5 < high <= 0.75
    assert np.isnan(Evaluation({"possession_share": np.array([np.nan])}).mean("possession_share"))


def test_won_drawn_and_lost_are_counted():
    goals = np.array([3.0, 1.0, 0.0, -2.0, -1.0, -1.0])
    assert Evaluation({"goal_difference": goals}).results == (2, 1, 3)


def play(seed, greedy=False):
    env = make_env(SCENARIO, num_envs=2, reward="scoring", seed=seed)
    torch.manual_seed(0)
    policy = build_actor_critic("simple115").get_collection_policy()
    with torch.no_grad():
        policy.policy_head.weight.mul_(300)
    progress = []
    result = evaluate(env, policy, 3, greedy=greedy, on_progress=progress.append)
    env.close()
    return result, progress


@pytest.fixture(scope="module")
def played():
    """Matches of the first seed, sampled."""
    return play(seed=1)


def test_each_place_plays_the_same_even_number_of_whole_matches(played):
    result, progress = played
    lengths = result.matches["length"]
    # 3 matches in 2 places: 2 each.
    assert len(lengths) == len(result.goal_differences) == 4
    assert progress[-1] == 4
    assert progress == sorted(progress)
    assert set(result.goal_differences) <= {-1, 0, 1}
    assert lengths.min() >= 5
    assert lengths.max() <= 401


def test_the_same_seed_gives_the_same_matches_and_another_one_others(played):
    first, _ = played
    again, _ = play(seed=1)
    other, _ = play(seed=2)
    np.testing.assert_array_equal(first.matches["length"], again.matches["length"])
    np.testing.assert_array_equal(first.goal_differences, again.goal_differences)
    assert first.matches["length"].tolist() != other.matches["length"].tolist()


def test_greedy_actions_play_other_matches_than_sampled_ones(played):
    sampled, _ = played
    greedy, _ = play(seed=1, greedy=True)
    assert sampled.matches["length"].tolist() != greedy.matches["length"].tolist()


def test_goals_are_counted_whatever_the_reward():
    env = make_env("academy_empty_goal_close", num_envs=2, reward="analytics", seed=0)
    policy = RandomPolicy(env.full_action_spec)

    def shoot(state):
        return policy(state).set("action", torch.full((2,), 12))

    result = evaluate(env, shoot, 4)
    env.close()
    assert result.goal_differences.tolist() == [1.0] * 4
    assert result.goal_difference == 1.0
    assert result.matches["goals_for"].tolist() == result.matches["shots"].tolist() == [1.0] * 4
    assert not result.matches["goals_against"].any()
    parts = [
        result.matches[f"reward_{name}"] for name in ("scoring", "start_density", "end_density")
    ]
    assert parts[0].tolist() == [1.0] * 4
    np.testing.assert_allclose(result.matches["reward"], sum(parts), rtol=1e-6)


def test_figures_of_a_match_are_its_own_and_whole():
    raw = ("ball_owned_team",)
    env = make_env(SCENARIO, num_envs=2, reward="scoring", keep_keys=raw, seed=3)
    policy = make_policy("random")
    torch.manual_seed(0)
    owned = {0: [[0, 0]], 1: [[0, 0]]}
    shares = []
    for following, counted in play_matches(env, policy, 6):
        for place in counted.nonzero().squeeze(-1).tolist():
            team = following["ball_owned_team"][place].item()
            if team >= 0:
                owned[place][-1][team] += 1
            if following["done"][place].item():
                ours, theirs = owned[place][-1]
                shares.append(ours / (ours + theirs) if ours + theirs else np.nan)
                owned[place].append([0, 0])
    env.set_seed(3)
    torch.manual_seed(0)
    result = evaluate(env, policy, 6)
    env.close()
    assert [len(matches) - 1 for matches in owned.values()] == [4, 4]
    np.testing.assert_allclose(result.matches["possession_share"], shares)
