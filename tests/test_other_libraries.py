"""What other libraries ask of environments: Stable-Baselines3's checks, TorchRL's info."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from torchrl.envs import GymEnv, check_env_specs

import fbrl  # noqa: F401 (registers the ids)
from fbrl.envs import FootballEnv, FootballVectorEnv, make_env

SCENARIO = "academy_empty_goal_close"
ID = f"fbrl/{SCENARIO}-v0"


def test_every_info_names_the_episodes_seed_as_numpy():
    env = FootballEnv(SCENARIO)
    _, info = env.reset(seed=7)
    infos = [info, env.step(5)[-1]]
    assert infos == [{"engine_seed": 7}] * 2
    assert all(isinstance(one["engine_seed"], np.int64) for one in infos)
    matches = FootballVectorEnv(SCENARIO, 2)
    _, info = matches.reset(seed=[7, 8])
    for one in (info, matches.step(np.array([5, 5]))[-1]):
        assert one["engine_seed"].tolist() == [7, 8]
        assert one["_engine_seed"].tolist() == [True, True]
    matches.close()


def test_torchrl_registers_the_info_of_a_single_environment():
    env = GymEnv(ID, categorical_action_encoding=True).auto_register_info_dict()
    check_env_specs(env)
    played = env.rollout(20)
    assert (played["engine_seed"] == played["next", "engine_seed"]).all()


def test_torchrl_registers_the_info_of_make_env():
    env = make_env(SCENARIO, num_envs=2, seed=1)
    env.auto_register_info_dict()
    check_env_specs(env)
    played = env.rollout(600, break_when_any_done=False)
    assert played["engine_seed"].dtype == torch.int64
    begun = played["next", "done"][:, :-1, 0]
    changed = played["engine_seed"][:, 1:] != played["engine_seed"][:, :-1]
    assert begun.any()
    assert torch.equal(changed, begun)
    env.close()


def test_what_would_lose_last_states_in_torchrl_names_what_to_use():
    with pytest.raises(ValueError, match=rf"make_env\('{SCENARIO}', num_envs=N\)"):
        GymEnv(ID, num_envs=2, categorical_action_encoding=True)


class TestStableBaselines3:
    def test_its_checks_pass(self):
        check_env = pytest.importorskip("stable_baselines3.common.env_checker").check_env
        with warnings.catch_warnings():
            # It would rather have planar arrays flattened, which it does itself.
            warnings.filterwarnings("ignore", "Your observation .* has an unconventional shape")
            check_env(gymnasium.make(ID))

    def test_its_ppo_learns_from_the_whole_observation(self):
        ppo = pytest.importorskip("stable_baselines3").PPO
        model = ppo("MultiInputPolicy", gymnasium.make(ID), n_steps=64, batch_size=32, device="cpu")
        model.learn(128)
        assert model.num_timesteps == 128


def test_make_env_has_single_numbers_without_a_dimension_of_their_own():
    env = make_env(SCENARIO, num_envs=2, keep_keys=["active", "steps_left"], seed=0)
    assert env.rollout(3)["active"].shape == (2, 3)
    assert env.observation_spec["steps_left"].shape == (2,)
    env.close()
