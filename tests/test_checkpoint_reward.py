"""CheckpointReward and ScoringReward, against gfootball's own CheckpointRewardWrapper."""

from __future__ import annotations

import doctest
import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from gfootball_oracle import import_gfootball, shoot_near_goal
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_matches import INTEGERS, ScriptedMatches, episodes, stored_trajectory
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, GymWrapper, ParallelEnv, RewardSum, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.transforms import CheckpointReward, ScoringReward


class GfootballWrapper:
    """gfootball's wrapper, given one observation and reward at a time."""

    def __init__(self) -> None:
        wrappers = import_gfootball("wrappers")
        self.wrapper = object.__new__(wrappers.CheckpointRewardWrapper)
        self.wrapper.env = SimpleNamespace(
            unwrapped=SimpleNamespace(observation=lambda: [self.observation]), reset=lambda: None
        )
        self.wrapper._num_checkpoints = 10
        self.wrapper._checkpoint_reward = 0.1
        self.wrapper.reset()

    def reset(self) -> None:
        self.wrapper.reset()

    def step(self, observation: dict[str, Any], scoring: float) -> float:
        # gfootball has the engine's single-precision positions in double precision.
        self.observation = observation | {"ball": observation["ball"].astype(np.float64)}
        return float(self.wrapper.reward(np.array([scoring], np.float32))[0])

    @property
    def collected(self) -> int:
        return self.wrapper._collected_checkpoints.get(0, 0)


def assert_paid_as_gfootball_pays(data: TensorDictBase) -> None:
    """Every row must start with the start of an episode."""
    for row in data.reshape(-1, data.shape[-1]).unbind(0):
        oracle = GfootballWrapper()
        for step in row:
            after = step["next"]
            observation = {key: int(after[key]) for key in INTEGERS}
            observation["ball"] = after["ball"].numpy()
            scoring = float(after["reward_scoring"])
            assert int(step["checkpoints_collected"]) == oracle.collected
            expected = oracle.step(observation, scoring)
            assert float(after["reward"]) == pytest.approx(expected, abs=1e-6)
            assert float(after["reward_checkpoint"]) == pytest.approx(expected - scoring, abs=1e-6)
            assert int(after["checkpoints_collected"]) == oracle.collected
            if after["done"].any():
                oracle.reset()


@pytest.mark.parametrize("module", ["checkpoint_reward", "scoring_reward"])
def test_the_docstrings_examples_run(module):
    result = doctest.testmod(importlib.import_module(f"fbrl.transforms.{module}"))
    assert result.attempted > 0
    assert result.failed == 0


@given(played=st.lists(episodes(), min_size=1, max_size=4))
@settings(deadline=None, max_examples=100)
def test_any_match(played):
    # The ball is always somewhere in gfootball; its wrapper would pay NaN as if at the goal.
    for first, steps in played:
        for state in (first, *(state for state, _ in steps)):
            state["ball"] = np.nan_to_num(state["ball"], nan=0.3)
    assert_paid_as_gfootball_pays(CheckpointReward()(stored_trajectory(played)))


def with_ball_at(x: float, y: float = 0.0, *, active: int = 1, team: int = 0) -> dict[str, Any]:
    ball = np.array([x, y, 0.0], np.float32)
    return {
        "ball": ball,
        "ball_owned_team": team,
        "ball_owned_player": 1,
        "active": active,
        "game_mode": 0,
    }


def paid_for(*steps: tuple[dict[str, Any], float]) -> list[float]:
    data = CheckpointReward()(stored_trajectory([(with_ball_at(-0.5), list(steps))]))
    assert_paid_as_gfootball_pays(data)
    return [round(paid, 5) for paid in data["next", "reward_checkpoint"].flatten().tolist()]


def test_each_distance_is_paid_once():
    run = [(with_ball_at(x), 0.0) for x in (0.0, 0.05, 0.05, 0.02, 0.5, 0.9, 0.0, 0.95)]
    assert paid_for(*run) == [0, 0.1, 0, 0, 0.5, 0.4, 0, 0]


def test_a_goal_pays_the_rest_and_nothing_after_it():
    goal = (with_ball_at(0.0, team=-1), 1.0)
    assert paid_for((with_ball_at(0.5), 0.0), goal, (with_ball_at(0.9), 0.0)) == [0.6, 0.4, 0]


def test_a_goal_against_pays_nothing():
    assert paid_for((with_ball_at(-0.9, team=-1), -1.0)) == [0]


def test_others_with_the_ball_earn_nothing():
    mate, opponent, nobody = (
        with_ball_at(0.9, active=2),
        with_ball_at(0.9, team=1),
        with_ball_at(0.9, team=-1),
    )
    assert paid_for((mate, 0.0), (opponent, 0.0), (nobody, 0.0)) == [0, 0, 0]


def test_the_ball_at_reset_is_not_paid_and_not_forgotten():
    data = stored_trajectory([(with_ball_at(0.5), [(with_ball_at(0.5), 0.0)])])
    assert CheckpointReward()(data)["next", "reward_checkpoint"].item() == pytest.approx(0.6)


@pytest.mark.parametrize("k", range(10))
def test_the_thresholds_are_gfootballs_to_the_last_bit(k):
    threshold = 0.99 - 0.8 / 9 * k
    near = np.nextafter(np.float32(1 - threshold), np.float32([-2, 2]))
    for x in (*np.linspace(near[0], near[1], 7, dtype=np.float32), np.float32(1 - threshold)):
        paid_for((with_ball_at(float(x)), 0.0))


def test_a_ball_exactly_at_a_threshold_collects_it():
    tried = 0
    for k in range(10):
        threshold = 0.99 - 0.8 / 9 * k
        x = np.float64(1 - threshold)
        for _ in range(4):
            if ((x - 1) ** 2 + 0.0**2) ** 0.5 == threshold:
                tried += 1
                state = with_ball_at(0.0) | {"ball": np.array([x, 0.0, 0.0])}
                assert paid_for((state, 0.0)) == [pytest.approx(0.1 * (k + 1))]
            x = np.nextafter(x, 2)
    assert tried >= 5


def test_a_ball_that_is_nowhere_collects_nothing():
    data = stored_trajectory([(with_ball_at(0.0), [(with_ball_at(float("nan")), 0.0)])])
    assert CheckpointReward()(data)["next", "reward_checkpoint"].item() == 0


def scripted(reward: type, *, batched: bool = True, seed: int = 0) -> TransformedEnv:
    base = ScriptedMatches() if batched else ScriptedMatches((5,), batched=False, seed=seed)
    return TransformedEnv(base, reward())


def scripted_single() -> TransformedEnv:
    return scripted(CheckpointReward, batched=False, seed=1)


def single_matches(reward: type) -> TransformedEnv:
    return scripted(reward, batched=False)


def serial_of_transformed(reward: type) -> SerialEnv:
    makers = [lambda s=seed: scripted(reward, batched=False, seed=s) for seed in range(2)]
    return SerialEnv(2, makers)


def transformed_serial(reward: type) -> TransformedEnv:
    makers = [lambda s=seed: ScriptedMatches((3 + s,), batched=False, seed=s) for seed in (0, 2)]
    return TransformedEnv(SerialEnv(2, makers), reward())


ARRANGEMENTS = [single_matches, scripted, serial_of_transformed, transformed_serial]


@pytest.mark.parametrize("make", ARRANGEMENTS)
def test_checkpoints_inside_torchrl_and_relabelled(make):
    env = make(CheckpointReward)
    check_env_specs(env, break_when_any_done="both")
    data = env.rollout(80, break_when_any_done=False)
    assert (data["next", "reward_scoring"] == 1).any()
    assert data["next", "reward_checkpoint"].any()
    assert_paid_as_gfootball_pays(data)

    stored = data.clone()
    stored["next", "reward"] = stored["next", "reward_scoring"]
    stored = stored.exclude(
        "checkpoints_collected",
        *(
            ("next", key)
            for key in ("reward_scoring", "reward_checkpoint", "checkpoints_collected")
        ),
    )
    once = CheckpointReward()(stored)
    assert (once == data).all()
    assert (CheckpointReward()(once.clone()) == data).all()


@pytest.mark.parametrize("make", ARRANGEMENTS)
def test_scoring_inside_torchrl_and_relabelled(make):
    env = make(ScoringReward)
    check_env_specs(env, break_when_any_done="both")
    data = env.rollout(80, break_when_any_done=False)
    assert data["next", "reward"].any()
    assert (data["next", "reward_scoring"] == data["next", "reward"]).all()
    assert set(env.reward_keys) == {"reward", "reward_scoring"}
    assert (ScoringReward()(data.clone()) == data).all()


@pytest.mark.slow
def test_checkpoints_in_parallel():
    env = ParallelEnv(2, scripted_single)
    try:
        check_env_specs(env)
        data = env.rollout(60, break_when_any_done=False)
    finally:
        env.close(raise_if_closed=False)
    assert_paid_as_gfootball_pays(data)


@pytest.mark.parametrize("reward", [CheckpointReward, ScoringReward])
def test_the_parts_sum_to_the_reward_over_each_episode(reward):
    parts = reward().part_names
    env = TransformedEnv(
        ScriptedMatches(), Compose(reward(), RewardSum(in_keys=["reward", *parts]))
    )
    check_env_specs(env)
    data = env.rollout(60, break_when_any_done=False)
    together = sum(data["next", f"episode_{part}"] for part in parts)
    torch.testing.assert_close(together, data["next", "episode_reward"])
    if reward is CheckpointReward:
        total = data["next", "episode_reward_checkpoint"]
        assert total.max() == pytest.approx(1.0)


def test_a_replay_buffer_of_shuffled_transitions():
    data = scripted(CheckpointReward).rollout(60, break_when_any_done=False).reshape(-1)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(len(data)), transform=CheckpointReward(), batch_size=64
    )
    buffer.extend(data)
    sample = buffer.sample()
    assert (sample["next", "reward"] == data[sample["index"]]["next", "reward"]).all()


def attacker(seed: int) -> TensorDictModule:
    random = np.random.default_rng(seed)

    def policy(ball: torch.Tensor) -> torch.Tensor:
        places = ball.reshape(-1, 3)[:, 0].tolist()
        actions = [shoot_near_goal(int(random.integers(7)), x) for x in places]
        return torch.nn.functional.one_hot(torch.tensor(actions), 19).view(*ball.shape[:-1], 19)

    return TensorDictModule(policy, in_keys=["ball"], out_keys=["action"])


@pytest.mark.parametrize(
    ("scenario", "scores"),
    [("academy_empty_goal", True), ("academy_run_to_score", True), ("5_vs_5", False)],
)
def test_real_matches(scenario, scores):
    env = TransformedEnv(GymWrapper(FootballVectorEnv(scenario, num_envs=2)), CheckpointReward())
    env.set_seed(5)
    check_env_specs(env)
    data = env.rollout(400, attacker(0), break_when_any_done=False)
    env.close()
    assert data["next", "reward_checkpoint"].any()
    assert (data["next", "reward_scoring"] == 1).any() or not scores
    assert_paid_as_gfootball_pays(data)


def test_a_real_match_on_its_own():
    env = TransformedEnv(GymWrapper(FootballEnv("academy_empty_goal_close")), CheckpointReward())
    env.set_seed(5)
    check_env_specs(env)
    data = env.rollout(200, attacker(0), break_when_any_done=False)
    env.close()
    assert (data["next", "reward_scoring"] == 1).any()
    assert_paid_as_gfootball_pays(data)
