"""Collection on real matches: where things run, and with how many threads."""

from __future__ import annotations

import pytest
import torch

from fbrl.collect import MatchCollector
from fbrl.collect.collector import inference_threads, torch_threads
from fbrl.config import PPOConfig
from fbrl.models import build_actor_critic
from fbrl.ppo.algorithm import PPO

SMALL = PPOConfig(total_frames=64, num_envs=2, num_steps=16, num_minibatches=2)


@pytest.fixture
def two_threads():
    with torch_threads(2):
        yield


def interrupted_computation():
    with torch_threads(1):
        assert torch.get_num_threads() == 1
        raise KeyboardInterrupt


def test_threads_are_as_before_after_an_interruption(two_threads):
    with pytest.raises(KeyboardInterrupt):
        interrupted_computation()
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize(("observation", "threads"), [("simple115", 1), ("minimap", 2)])
def test_only_the_convolutional_network_shares_the_cores_with_nobody(
    observation, threads, two_threads
):
    policy = build_actor_critic(observation).get_collection_policy()
    assert inference_threads(policy) == threads


def test_collection_takes_one_thread_for_a_perceptron_and_learning_all(two_threads):
    torch.manual_seed(0)
    model = build_actor_critic("simple115")
    seen: list[tuple[str, int]] = []
    phase = ["collect"]
    model[0].module.register_forward_hook(
        lambda *_: seen.append((phase[0], torch.get_num_threads()))
    )
    policy = model.get_collection_policy()
    collector = MatchCollector("academy_empty_goal_close", policy, num_envs=2, num_steps=16, seed=0)
    ppo = PPO(collector, model, SMALL)
    ppo.collect()
    seen.clear()
    batch = ppo.collect()
    phase[0] = "learn"
    ppo.learn(batch)
    collector.close()
    assert set(seen) == {("collect", 1), ("learn", 2)}
    assert batch.device == torch.device("cpu")
