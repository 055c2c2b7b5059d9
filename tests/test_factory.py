"""make_env: any observation with any reward, episode sums, and no raw keys left over."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from fbrl.envs import OBSERVATION_SPACE, make_env
from fbrl.transforms import AssistDensityPotential, AssistDensityReward, MiniMapCells

PARTS = {
    "analytics": ["reward_scoring", "reward_start_density", "reward_end_density"],
    "potential": ["reward_scoring", "reward_potential"],
    "checkpoints": ["reward_scoring", "reward_checkpoint"],
    "scoring": ["reward_scoring"],
}
OBSERVATION_KEYS = {
    "minimap": "minimap_cells",
    "smm": "smm",
    "simple115": "simple115",
    "players": "players",
}


@pytest.mark.parametrize("reward", PARTS)
@pytest.mark.parametrize("observation", OBSERVATION_KEYS)
def test_any_observation_goes_with_any_reward(observation, reward):
    env = make_env(
        "academy_3_vs_1_with_keeper",
        num_envs=2,
        reward=AssistDensityPotential(gamma=0.9) if reward == "potential" else reward,
        observation=observation,
        seed=0,
    )
    check_env_specs(env)
    data = env.rollout(120, break_when_any_done=False)
    env.close()
    following = data["next"]
    assert OBSERVATION_KEYS[observation] in data
    assert not set(OBSERVATION_SPACE) & set(data.keys()), "raw keys are dropped"
    assert not set(OBSERVATION_SPACE) & set(following.keys())
    total = sum(following[part] for part in PARTS[reward])
    torch.testing.assert_close(following["reward"], total)
    for name in ["reward", *PARTS[reward]]:
        assert_summed_per_episode(following[name], following[f"episode_{name}"], following["done"])


def assert_summed_per_episode(values, sums, done):
    for value, total, end in zip(values, sums, done, strict=True):
        running = 0.0
        for step in range(len(value)):
            running += value[step].item()
            assert total[step].item() == pytest.approx(running, abs=1e-5)
            if end[step]:
                running = 0.0


def test_the_step_count_restarts_with_each_match():
    torch.manual_seed(1)
    env = make_env("academy_3_vs_1_with_keeper", num_envs=2, reward="scoring", seed=0)
    data = env.rollout(200, break_when_any_done=False)["next"]
    env.close()
    assert data["done"].any()
    for count, done in zip(data["step_count"].tolist(), data["done"].tolist(), strict=True):
        expected = 0
        for step in range(200):
            expected += 1
            assert count[step] == [expected]
            if done[step][0]:
                expected = 0


def test_keys_can_be_kept():
    env = make_env("academy_empty_goal", num_envs=2, keep_keys=["ball", "score"], seed=0)
    data = env.rollout(3)
    env.close()
    assert data["ball"].shape == (2, 3, 3)
    assert data["next", "score"].shape == (2, 3, 2)
    assert "left_team" not in data


def test_transforms_of_ones_own_are_taken_as_they_are():
    env = make_env(
        "academy_empty_goal",
        num_envs=2,
        reward=AssistDensityReward(transition="consecutive", weight=2.0),
        observation=MiniMapCells(num_frames=2),
        seed=0,
    )
    data = env.rollout(3)
    env.close()
    assert data["minimap_cells"].shape == (2, 3, 2, 24)
    assert "last_active" in data


def test_the_seed_decides_the_matches():
    def balls(seed):
        env = make_env("academy_counterattack_hard", num_envs=2, keep_keys=["ball"], seed=seed)
        torch.manual_seed(0)
        ball = env.rollout(20)["ball"]
        env.close()
        return ball

    assert torch.equal(balls(1), balls(1))
    assert not torch.equal(balls(1), balls(2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "analytic"}, "no reward 'analytic'. Did you mean analytics"),
        ({"observation": "simple"}, "no observation 'simple'. Did you mean simple115"),
        ({"keep_keys": ["balls"]}, "Unknown observation keys"),
        ({"num_envs": 0}, "num_envs is 0"),
    ],
)
def test_wrong_names_are_answered_with_the_right_ones(options, message):
    with pytest.raises(ValueError, match=message):
        make_env("academy_empty_goal", **options)


def test_the_environment_says_that_it_is_on_the_cpu():
    """So that a policy's actions come back from a GPU."""
    env = make_env("academy_empty_goal", num_envs=2, seed=0)
    assert env.device == torch.device("cpu")
    assert env.rollout(2).device == torch.device("cpu")
    env.close()


@pytest.mark.parametrize("observation", OBSERVATION_KEYS)
def test_specs_hold_whatever_the_default_dtype_of_floating_point(observation):
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        env = make_env("academy_empty_goal", num_envs=2, observation=observation, seed=0)
        check_env_specs(env)
        env.close()
    finally:
        torch.set_default_dtype(before)
