"""TorchRL's own collectors over make_env: the batches of fbrl's collector."""

from __future__ import annotations

import functools

import pytest
import torch
from torchrl.collectors import Collector, MultiAsyncCollector, MultiSyncCollector
from torchrl.envs import GymEnv

from fbrl.collect import MatchCollector
from fbrl.envs import make_env
from fbrl.models.actor_critic import build_actor_critic

SCENARIO = "academy_3_vs_1_with_keeper"


def make_policy():
    torch.manual_seed(0)
    return build_actor_critic("simple115").get_collection_policy()


@pytest.mark.parametrize("devices", [{}, {"device": "cpu"}, {"storing_device": "cpu"}])
def test_a_collector_has_the_batches_of_fbrls_own(devices):
    policy = make_policy()
    ours = MatchCollector(SCENARIO, policy, num_envs=3, num_steps=40, num_groups=1, seed=5)
    torch.manual_seed(1)
    expected = [ours.collect().clone() for _ in range(3)]
    ours.close()
    theirs = Collector(
        make_env(SCENARIO, num_envs=3, seed=5),
        policy,
        frames_per_batch=120,
        total_frames=360,
        trust_policy=True,
        auto_register_policy_transforms=False,
        **devices,
    )
    torch.manual_seed(1)
    batches = [batch.clone() for batch in theirs]
    theirs.shutdown()
    assert len(batches) == 3
    for batch, own in zip(batches, expected, strict=True):
        # What is remembered after a step is nobody's business but the next step's.
        shared = set(own.keys(True, True)) - {("next", "play_memory")}
        assert shared <= set(batch.keys(True, True))
        for key in shared:
            assert torch.equal(batch[key], own[key]), key


@pytest.mark.slow
@pytest.mark.parametrize("collector_class", [MultiSyncCollector, MultiAsyncCollector])
def test_collectors_with_processes_play(collector_class):
    makers = [functools.partial(make_env, SCENARIO, num_envs=2, seed=seed) for seed in (5, 6)]
    collector = collector_class(
        makers, make_policy(), frames_per_batch=160, total_frames=320, trust_policy=True
    )
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    assert sum(batch.numel() for batch in batches) == 320
    for batch in batches:
        assert batch["next", "simple115"].isfinite().all()
        assert batch["next", "step_count"].min() >= 1
        assert len(batch["action"].unique()) > 12


def test_a_single_match_by_its_gymnasium_name_is_collected():
    env = GymEnv(f"fbrl/{SCENARIO}-v0", categorical_action_encoding=True)
    collector = Collector(env, frames_per_batch=50, total_frames=100)
    batches = list(collector)
    collector.shutdown()
    assert [tuple(batch.shape) for batch in batches] == [(50,), (50,)]
    assert batches[0]["next", "ball"].isfinite().all()
