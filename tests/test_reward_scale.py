"""Rewards in units of the returns so far."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from fbrl.ppo.algorithm import RewardScale


def batch_of(reward, done):
    reward, done = torch.tensor(reward)[..., None], torch.tensor(done)[..., None]
    return TensorDict(next={"reward": reward, "done": done}, batch_size=reward.shape[:2])


def test_it_is_the_root_mean_square_of_the_discounted_returns():
    batch = batch_of([[0.0, 1.0, 2.0], [0.0, 0.0, 4.0]], [[False, True, False]] * 2)
    # Backwards: 2, 1, 0.5 and 4, 0, 0.
    assert RewardScale(0.5).update(batch) == pytest.approx(((4 + 1 + 0.25 + 16) / 6) ** 0.5)


def test_it_is_as_large_as_the_rewards_and_forgets_slowly():
    scale = RewardScale(0.9)
    done = [[False, False, True]]
    small = batch_of([[0.0, 0.01, 0.0]], done)
    first = [scale.update(small) for _ in range(50)]
    assert first == pytest.approx([first[0]] * 50)
    large = batch_of([[0.0, 1.0, 0.0]], done)
    assert first[0] < scale.update(large) < 100 * first[0]
    for _ in range(2000):
        latest = scale.update(large)
    assert latest == pytest.approx(100 * first[0], rel=1e-4)


def test_without_any_reward_nothing_is_divided():
    assert RewardScale(0.9).update(batch_of([[0.0, 0.0]], [[False, False]])) == 1.0


def test_it_goes_on_from_a_state():
    batch, other = batch_of([[1.0, 2.0]], [[False, False]]), RewardScale(0.9)
    scale = RewardScale(0.9)
    scale.update(batch)
    other.load_state_dict(scale.state_dict())
    assert other.update(batch * 3) == scale.update(batch * 3)
