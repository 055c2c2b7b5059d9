"""Whole batches are completed with the numbers that stepping one by one gives."""

from __future__ import annotations

import pytest
import torch

from fbrl.collect import make_collection_env
from fbrl.collect.collector import RolloutCollector
from fbrl.envs import OBSERVATION_SPACE, make_env
from fbrl.models.actor_critic import build_actor_critic
from fbrl.transforms import AssistDensityPotential, AssistDensityReward

SCENARIO = "academy_3_vs_1_with_keeper"


def collected(env, bookkeeping, observation, num_batches):
    torch.manual_seed(0)
    policy = build_actor_critic(observation).get_collection_policy()
    torch.manual_seed(1)
    collector = RolloutCollector(env, policy, 50, bookkeeping)
    batches = [collector.collect().clone() for _ in range(num_batches)]
    env.close()
    return batches


@pytest.mark.parametrize(
    ("reward", "observation"),
    [
        ("analytics", "simple115"),
        ("checkpoints", "minimap"),
        ("scoring", "simple115"),
        (AssistDensityPotential(gamma=0.9), "simple115"),
        (AssistDensityReward(episode_cap=0.005), "simple115"),
    ],
)
def test_a_batch_has_the_numbers_of_single_steps(reward, observation):
    arguments = {"num_envs": 3, "observation": observation, "seed": 5}
    env, bookkeeping = make_collection_env(SCENARIO, reward=reward, **arguments)
    batches = collected(env, bookkeeping, observation, 4)
    expected = collected(make_env(SCENARIO, reward=reward, **arguments), None, observation, 4)

    ends = torch.cat([batch["next", "done"] for batch in batches], 1)
    assert ends.sum() >= 3, "matches end, also in the middle of batches"
    for batch, single_steps in zip(batches, expected, strict=True):
        for key, value in single_steps["next"].items():
            if key == "play_memory":
                continue
            torch.testing.assert_close(
                batch["next", key], value, rtol=0, atol=0, msg=f"{key} differs"
            )
        assert not set(OBSERVATION_SPACE) & {*batch.keys(), *batch["next"].keys()}
        for key in ("action", "action_log_prob", "state_value"):
            assert torch.equal(batch[key], single_steps[key])
