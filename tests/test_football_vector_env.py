"""FootballVectorEnv alone, and as TorchRL uses it."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gfootball_oracle import shoot_near_goal
from gymnasium.vector import AutoresetMode
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.envs.utils import RandomPolicy, check_env_specs

from fbrl.checks import UnknownNameError
from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.envs.arguments import spread_seed

SCENARIO = "academy_3_vs_1_with_keeper"
# The engine counts from -1 at a reset, so that an episode has one step more than its duration.
FIRST_STEPS_LEFT = 401


def assert_same(observation, expected, index):
    for key, value in expected.items():
        np.testing.assert_array_equal(observation[key][index], value, key)


@pytest.mark.parametrize("num_threads", [1, 3])
def test_each_match_equals_a_single_environment_with_its_seed(num_threads):
    seeds = [3, 4, 5]
    vector = FootballVectorEnv(SCENARIO, num_envs=3, num_threads=num_threads)
    singles = [FootballEnv(SCENARIO) for _ in seeds]
    observation, info = vector.reset(seed=seeds)
    assert info["engine_seed"].tolist() == seeds
    expected = [env.reset(seed=seed)[0] for env, seed in zip(singles, seeds, strict=True)]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(150):
        for index in range(3):
            assert_same(observation, expected[index], index)
        actions = rng.integers(19, size=3)
        observation, rewards, terminated, truncated, _ = vector.step(actions)
        done = terminated | truncated
        for index, env in enumerate(singles):
            expected[index], reward, term, trunc, _ = env.step(actions[index])
            assert (reward, term, trunc) == (rewards[index], terminated[index], truncated[index])
            assert_same(observation, expected[index], index)
            if done[index]:
                expected[index], _ = env.reset()
        if done.any():
            ends += done.sum()
            observation, _ = vector.reset(options={"reset_mask": done})
    assert ends >= 3
    vector.close()
    for env in singles:
        env.close()


def test_one_seed_gives_independent_matches_and_repeats_them():
    env = FootballVectorEnv(SCENARIO, num_envs=4)
    _, info = env.reset(seed=7)
    seeds = info["engine_seed"].tolist()
    assert len(set(seeds)) == 4
    _, later = env.reset()
    assert set(later["engine_seed"].tolist()).isdisjoint(seeds)
    _, info = env.reset(seed=7)
    assert info["engine_seed"].tolist() == seeds
    _, again = env.reset()
    assert again["engine_seed"].tolist() == later["engine_seed"].tolist()
    _, info = env.reset(seed=8)
    assert set(info["engine_seed"].tolist()).isdisjoint(seeds)
    env.close()


def test_observations_returned_earlier_are_not_written_over():
    env = FootballVectorEnv(SCENARIO, num_envs=2)
    first, _ = env.reset(seed=1)
    kept = {key: value.copy() for key, value in first.items()}
    env.step(np.array([5, 5]))
    for key, value in kept.items():
        np.testing.assert_array_equal(first[key], value)
    env.close()


def test_resetting_some_matches_leaves_the_others_where_they_are():
    env = FootballVectorEnv("academy_counterattack_hard", num_envs=3)
    env.reset(seed=1)
    before, *_ = env.step(np.array([5, 5, 5]))
    seeds = [seed for seed, _ in env.episodes]
    after, info = env.reset(options={"reset_mask": np.array([False, True, False])})
    assert (info["engine_seed"] != seeds).tolist() == [False, True, False]
    left = before["steps_left"]
    assert after["steps_left"].tolist() == [left[0], FIRST_STEPS_LEFT, left[2]]
    for index in (0, 2):
        assert_same(after, {key: value[index] for key, value in before.items()}, index)
    env.close()


def test_gymnasium_can_make_it():
    env = gymnasium.make_vec(f"fbrl/{SCENARIO}-v0", num_envs=2)
    assert isinstance(env.unwrapped, FootballVectorEnv)
    assert env.metadata["autoreset_mode"] == AutoresetMode.DISABLED
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    env.close()
    with pytest.raises(ValueError, match=r"max_episode_steps is 50.* 401 steps.*game_duration"):
        gymnasium.make_vec(f"fbrl/{SCENARIO}-v0", num_envs=2, max_episode_steps=50)
    for no_other in (-1, None):
        gymnasium.make_vec(f"fbrl/{SCENARIO}-v0", num_envs=2, max_episode_steps=no_other).close()


def test_passes_torchrls_checks():
    env = GymWrapper(FootballVectorEnv(SCENARIO, num_envs=3), categorical_action_encoding=True)
    check_env_specs(env)
    env.close()


@pytest.mark.parametrize("frames_per_batch", [100, 400])
def test_no_step_is_lost_doubled_or_junk_under_torchrls_collector(frames_per_batch):
    """Episodes of different lengths: each must be counted down by one from its first step on."""
    vector = FootballVectorEnv(SCENARIO, num_envs=4)
    env = GymWrapper(vector, categorical_action_encoding=True)
    env.set_seed(0)
    collector = Collector(
        env,
        RandomPolicy(env.full_action_spec),
        frames_per_batch=frames_per_batch,
        total_frames=2400,
        auto_register_policy_transforms=False,
    )
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    data = torch.cat(batches, dim=1)
    assert data.shape == (4, 600)
    before, after = data["steps_left"], data["next", "steps_left"]
    assert (before - after == 1).all(), "each step takes one step of the match"
    done = data["next", "done"].squeeze(-1)
    assert done.sum() > 12
    assert len(set(before[:, :-1][done[:, :-1]].tolist())) > 5, "lengths are staggered"
    assert (before[:, 0] == FIRST_STEPS_LEFT).all()
    assert (before[:, 1:][done[:, :-1]] == FIRST_STEPS_LEFT).all(), (
        "an episode begins at its first step"
    )
    going_on = ~done[:, :-1]
    assert (before[:, 1:][going_on] == after[:, :-1][going_on]).all()
    assert torch.equal(data["ball"][:, 1:][going_on], data["next", "ball"][:, :-1][going_on])
    start = data["ball"][:, 1:][done[:, :-1]]
    assert (start[:, 0] - 0.62).abs().max() < 0.02, "the first state is that of the scenario"


def test_a_collected_trajectory_replays_in_single_environments():
    """The data of the collector against the same actions in plain Gymnasium environments."""
    vector = FootballVectorEnv(SCENARIO, num_envs=2)
    env = GymWrapper(vector, categorical_action_encoding=True)
    vector_seeds = spread_seed(3, vector.num_envs)
    env.set_seed(3)
    collector = Collector(
        env,
        RandomPolicy(env.full_action_spec),
        frames_per_batch=300,
        total_frames=300,
        auto_register_policy_transforms=False,
    )
    data = next(iter(collector)).clone()
    collector.shutdown()
    for index, seed in enumerate(vector_seeds):
        single = FootballEnv(SCENARIO)
        single.reset(seed=seed)
        observation, _ = single.reset()
        for step in range(150):
            np.testing.assert_array_equal(data["ball"][index, step], observation["ball"])
            observation, reward, terminated, truncated, _ = single.step(
                int(data["action"][index, step])
            )
            after = data["next"][index, step]
            np.testing.assert_array_equal(after["left_team"], observation["left_team"])
            assert after["reward"].item() == reward
            assert after["terminated"].item() == terminated
            assert after["truncated"].item() == truncated
            if terminated or truncated:
                observation, _ = single.reset()
        single.close()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.array([0]), r"shape \(1,\)"),
        (np.array([0.0, 1.0]), "dtype float64"),
        (np.array([0, 19]), r"\[0, 19\] are not all in \[0, 18\]"),
        (None, "dtype object"),
    ],
)
def test_bad_actions_are_named(actions, message):
    env = FootballVectorEnv(SCENARIO, num_envs=2)
    env.reset(seed=1)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    env.close()


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="num_envs is 0"):
        FootballVectorEnv(SCENARIO, num_envs=0)
    with pytest.raises(ValueError, match="num_threads is 0"):
        FootballVectorEnv(SCENARIO, num_envs=1, num_threads=0)
    env = FootballVectorEnv(SCENARIO, num_envs=2)
    with pytest.raises(ValueError, match="3 seeds for 2 matches"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="reset_mask has shape"):
        env.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(np.array([0, 0]))
    env.close()


def test_action_set_v2_lets_the_engines_own_player_decide():
    env = FootballVectorEnv("academy_empty_goal_close", 2, action_set="v2")
    assert env.single_action_space.n == 20
    env.reset(seed=1)
    for _ in range(60):
        _, rewards, terminated, _, _ = env.step(np.array([19, 19]))
        if terminated.any():
            break
    assert rewards.max() == 1
    with pytest.raises(ValueError, match=r"not all in \[0, 19\]"):
        env.step(np.array([20, 0]))
    env.close()
    with pytest.raises(UnknownNameError, match="v2"):
        FootballVectorEnv("academy_empty_goal_close", 2, action_set="v3")


def test_an_ended_match_waits_for_its_reset_and_a_seed_overrules_what_was_begun():
    env = FootballVectorEnv("academy_empty_goal", num_envs=2)
    env.reset(seed=[3, 3])
    ended = np.zeros(2, bool)
    for step in range(400):
        _, _, terminated, truncated, _ = env.step(np.array([shoot_near_goal(step, 0.0), 0]))
        ended = terminated | truncated
        if ended.any():
            break
    assert ended.any()
    with pytest.raises(RuntimeError, match=r"have ended: call reset.*before step"):
        env.step(np.array([0, 0]))
    with pytest.raises(RuntimeError, match=r"have ended: call reset.*before get_state"):
        env.get_state()
    seeds = [7 if end else None for end in ended]
    observation, info = env.reset(seed=seeds, options={"reset_mask": ended})
    assert info["engine_seed"][ended].tolist() == [7] * ended.sum()
    alone = FootballEnv("academy_empty_goal")
    expected, _ = alone.reset(seed=7)
    for index in np.flatnonzero(ended):
        for key, value in expected.items():
            np.testing.assert_array_equal(observation[key][index], value)
    env.step(np.array([0, 0]))
    env.close()
    alone.close()
