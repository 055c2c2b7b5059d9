"""Advantages against the recursion written out, with every kind of end."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from fbrl.ppo.advantages import add_advantages, add_next_state_value, explained_variance

GAMMA, GAE_LAMBDA = 0.9, 0.8
RUNNING, TERMINATED, TRUNCATED = 0, 1, 2


class RecordingCritic(nn.Module):
    """V(observation) = 10 * observation, keeping what it was asked."""

    def __init__(self):
        super().__init__()
        self.asked = []

    def forward(self, observation):
        self.asked += observation.flatten().tolist()
        return 10 * observation


def make_batch(rewards, ends, observations, final_observations):
    """A batch of one-dimensional observations; each next one is given by the last argument."""
    shape = np.shape(rewards)
    observation = torch.tensor(observations, dtype=torch.float32).unsqueeze(-1)
    ends = torch.tensor(ends).unsqueeze(-1)
    return TensorDict(
        {
            "observation": observation,
            "state_value": 10 * observation,
            "next": {
                "observation": torch.tensor(final_observations, dtype=torch.float32).unsqueeze(-1),
                "reward": torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1),
                "done": ends != RUNNING,
                "terminated": ends == TERMINATED,
                "truncated": ends == TRUNCATED,
            },
        },
        batch_size=shape,
    )


def reference_advantages(batch):
    """Schulman et al. 2016, equation 16, backwards in plain Python."""
    value = batch["state_value"].squeeze(-1).numpy()
    following = batch["next", "observation"].squeeze(-1).numpy() * 10
    reward = batch["next", "reward"].squeeze(-1).numpy()
    done = batch["next", "done"].squeeze(-1).numpy()
    terminated = batch["next", "terminated"].squeeze(-1).numpy()
    advantage = np.zeros_like(value)
    for env in range(value.shape[0]):
        running = 0.0
        for t in reversed(range(value.shape[1])):
            bootstrap = 0.0 if terminated[env, t] else following[env, t]
            delta = reward[env, t] + GAMMA * bootstrap - value[env, t]
            running = delta + (0.0 if done[env, t] else GAMMA * GAE_LAMBDA * running)
            advantage[env, t] = running
    return advantage


@pytest.fixture
def batch():
    return make_batch(
        rewards=[[1, 0, 2, 0, 1], [0, 0, -1, 3, 0]],
        ends=[
            [RUNNING, TERMINATED, RUNNING, TRUNCATED, RUNNING],
            [TRUNCATED, RUNNING, RUNNING, RUNNING, TERMINATED],
        ],
        observations=[[1, 2, 3, 4, 5], [6, 7, 8, 9, 10]],
        # Inside an episode the next observation is that of the following step.
        final_observations=[[2, 20, 4, 40, 50], [60, 8, 9, 10, 100]],
    )


@pytest.fixture
def critic():
    network = RecordingCritic()
    return TensorDictModule(network, in_keys=["observation"], out_keys=["state_value"])


def test_next_values_are_shifted_and_only_unseen_states_are_evaluated(batch, critic):
    add_next_state_value(batch, critic)
    expected = [[20, 0, 40, 400, 500], [600, 80, 90, 100, 0]]
    assert batch["next", "state_value"].squeeze(-1).tolist() == expected
    # Cut off by the time limit, or by the batch's end; never a terminal state, none twice.
    assert sorted(critic.module.asked) == [40, 50, 60]


def test_advantages_equal_the_recursion(batch, critic):
    add_advantages(batch, critic, gamma=GAMMA, gae_lambda=GAE_LAMBDA)
    expected = reference_advantages(batch)
    np.testing.assert_allclose(batch["advantage"].squeeze(-1).numpy(), expected, rtol=1e-5)
    target = batch["value_target"] - batch["state_value"]
    np.testing.assert_allclose(target.squeeze(-1).numpy(), expected, rtol=1e-4, atol=1e-4)


def test_advantages_equal_the_recursion_on_random_episodes(critic):
    rng = np.random.default_rng(0)
    observations = rng.normal(size=(4, 61))
    ends = rng.choice([RUNNING, TERMINATED, TRUNCATED], p=[0.8, 0.1, 0.1], size=(4, 60))
    final = np.where(ends == RUNNING, observations[:, 1:], rng.normal(size=(4, 60)))
    batch = make_batch(rng.normal(size=(4, 60)), ends, observations[:, :-1], final)
    add_advantages(batch, critic, gamma=GAMMA, gae_lambda=GAE_LAMBDA)
    np.testing.assert_allclose(
        batch["advantage"].squeeze(-1).numpy(), reference_advantages(batch), rtol=1e-4, atol=1e-4
    )


def test_nothing_requires_gradients(batch, critic):
    critic.module.weight = nn.Parameter(torch.ones(()))
    add_advantages(batch, critic, gamma=GAMMA, gae_lambda=GAE_LAMBDA)
    assert not batch["advantage"].requires_grad


@pytest.mark.parametrize(
    ("value", "expected"), [([1.0, 2.0, 3.0], 1.0), ([2.0, 2.0, 2.0], 0.0), ([3.0, 2.0, 1.0], -3.0)]
)
def test_explained_variance(value, expected):
    batch = TensorDict(
        {"state_value": torch.tensor(value), "value_target": torch.tensor([1.0, 2.0, 3.0])}
    )
    assert explained_variance(batch).item() == pytest.approx(expected)
