"""The algorithm against Stable-Baselines3's PPO: equal returns on CartPole over several seeds."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium.vector import AutoresetMode
from scipy import stats
from stable_baselines3.common.env_util import make_vec_env
from torch import nn
from torchrl.envs import GymWrapper, RewardSum, TransformedEnv

from fbrl.collect import RolloutCollector
from fbrl.config import PPOConfig
from fbrl.models.actor_critic import ActorCritic
from fbrl.models.mlp import MLP
from fbrl.ppo.algorithm import PPO

SEEDS = range(6)
CONFIG = PPOConfig(
    total_frames=20_480,
    num_envs=8,
    num_steps=64,
    num_minibatches=4,
    num_epochs=6,
    learning_rate=1e-3,
    gamma=0.98,
    gae_lambda=0.9,
    clip_epsilon=0.2,
    entropy_coeff=0.0,
    critic_coeff=0.5,
    max_grad_norm=0.5,
)


class SharedTrunk(nn.Module):
    """Stable-Baselines3's features extractor, so that both sides have one trunk."""

    def __init__(self, observation_space, features_dim=64):
        super().__init__()
        self.features_dim = features_dim
        self.trunk = MLP((observation_space.shape[0],), (64, features_dim), "tanh")

    def forward(self, observation):
        return self.trunk(observation)


def our_returns(seed):
    """Mean return of the episodes that ended in each quarter of the training."""
    torch.manual_seed(seed)
    env = gymnasium.make_vec(
        "CartPole-v1",
        num_envs=CONFIG.num_envs,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
    )
    env = GymWrapper(env, categorical_action_encoding=True)
    env = TransformedEnv(env, RewardSum(in_keys=["reward"], out_keys=["episode_reward"]))
    env.set_seed(seed)
    model = ActorCritic(MLP((4,), (64, 64), "tanh"), "observation", 64, 2)
    ended = []
    collector = RolloutCollector(env, model.get_collection_policy(), CONFIG.num_steps)
    ppo = PPO(collector, model, CONFIG)
    while ppo.frames < CONFIG.total_frames:
        batch = ppo.collect()
        done = batch["next", "done"]
        ended += [(ppo.frames, r) for r in batch["next", "episode_reward"][done].tolist()]
        ppo.learn(batch)
    collector.close()
    return by_quarter(ended)


def peer_returns(seed):
    torch.manual_seed(seed)
    ppo = stable_baselines3.PPO(
        "MlpPolicy",
        make_vec_env("CartPole-v1", n_envs=CONFIG.num_envs, seed=seed),
        n_steps=CONFIG.num_steps,
        batch_size=CONFIG.steps_per_minibatch,
        n_epochs=CONFIG.num_epochs,
        learning_rate=lambda left: CONFIG.learning_rate * left,
        gamma=CONFIG.gamma,
        gae_lambda=CONFIG.gae_lambda,
        clip_range=CONFIG.clip_epsilon,
        ent_coef=CONFIG.entropy_coeff,
        vf_coef=CONFIG.critic_coeff,
        max_grad_norm=CONFIG.max_grad_norm,
        policy_kwargs={"features_extractor_class": SharedTrunk, "net_arch": []},
        seed=seed,
        device="cpu",
    )
    ended = []

    def record(local, _):
        for info in local["infos"]:
            if "episode" in info:
                ended.append((ppo.num_timesteps, info["episode"]["r"]))
        return True

    ppo.learn(CONFIG.total_frames, callback=record)
    return by_quarter(ended)


def by_quarter(ended):
    quarter = CONFIG.total_frames / 4
    return [
        np.mean([r for frames, r in ended if int(frames / quarter - 1e-9) == number])
        for number in range(4)
    ]


@pytest.mark.slow
def test_returns_on_cartpole_equal_those_of_stable_baselines3():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        ours = np.array([our_returns(seed) for seed in SEEDS])
        peers = np.array([peer_returns(seed) for seed in SEEDS])
    finally:
        torch.set_num_threads(threads)
    # Both have to learn, or equality would mean nothing: a random policy's return is 22.
    assert ours[:, -1].mean() > 66
    assert peers[:, -1].mean() > 66
    for quarter in range(4):
        test = stats.ttest_ind(ours[:, quarter], peers[:, quarter], equal_var=False)
        assert test.pvalue > 0.01, f"quarter {quarter}: {ours[:, quarter]} {peers[:, quarter]}"
    # Not being told apart is weak evidence with so few seeds; the means also have to be close.
    ratios = ours.mean(0) / peers.mean(0)
    assert (ratios > 0.85).all(), ratios
    assert (ratios < 1 / 0.85).all(), ratios
