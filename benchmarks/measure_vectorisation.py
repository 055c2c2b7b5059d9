"""Collection of experience with a small network, by several ways to step many matches."""

from __future__ import annotations

import functools
import time
from typing import Any

VECTORISATIONS = ("threads", "MultiSyncCollector", "ParallelEnv", "AsyncVectorEnv")
"""FootballVectorEnv's threads; TorchRL's processes, that collect or only step; Gymnasium's."""

_STEPS_PER_BATCH = 16


def collect(
    scenario: str, vectorisation: str, num_envs: int, seconds: float, seed: int
) -> dict[str, float]:
    """Collects with the light preset's network, its observation and the analytics reward.

    Args:
        scenario: What is played.
        vectorisation: One of :data:`VECTORISATIONS`.
        num_envs: Number of matches.
        seconds: How long to collect, after the first batch.
        seed: Seeds the network.

    Returns:
        ``frames_per_second``, resets of matches included.
    """
    import torch

    from fbrl.models.actor_critic import build_actor_critic

    # Spawned processes would import everything for seconds each; once they run there is no
    # difference.
    torch.multiprocessing.set_start_method("fork", force=True)
    torch.manual_seed(seed)
    policy = build_actor_critic("simple115", activation="relu").get_collection_policy()
    collector = _make_collector(scenario, vectorisation, num_envs, policy)
    batches = iter(collector)
    next(batches)
    frames = 0
    started = time.perf_counter()
    while time.perf_counter() - started < seconds:
        frames += next(batches).numel()
    took = time.perf_counter() - started
    collector.shutdown()
    return {"frames_per_second": frames / took}


def _make_collector(scenario: str, vectorisation: str, num_envs: int, policy: Any) -> Any:
    from torchrl.collectors import MultiSyncCollector

    from fbrl.collect import make_collector

    frames_per_batch = num_envs * _STEPS_PER_BATCH
    if vectorisation == "MultiSyncCollector":
        return MultiSyncCollector(
            [functools.partial(_make_env, scenario, "single", 1)] * num_envs,
            policy,
            frames_per_batch=frames_per_batch,
            total_frames=-1,
            trust_policy=True,
            auto_register_policy_transforms=False,
            cat_results="stack",
        )
    return make_collector(
        _make_env(scenario, vectorisation, num_envs),
        policy,
        frames_per_batch=frames_per_batch,
    )


def _make_env(scenario: str, vectorisation: str, num_envs: int) -> Any:
    """The training's transforms on matches that are stepped in one of the ways."""
    from torchrl.envs import Compose, ExcludeTransform, TransformedEnv

    from fbrl.envs import OBSERVATION_SPACE
    from fbrl.envs.factory import make_observation, make_reward

    reward, observation = make_reward("analytics"), make_observation("simple115")
    keys = sorted({*reward.in_keys, *observation.in_keys} & set(OBSERVATION_SPACE))
    matches = _make_matches(scenario, vectorisation, num_envs, keys)
    return TransformedEnv(matches, Compose(reward, observation, ExcludeTransform(*keys)))


def _make_matches(scenario: str, vectorisation: str, num_envs: int, keys: list[str]) -> Any:
    from gymnasium.vector import AsyncVectorEnv, AutoresetMode
    from torchrl.envs import GymWrapper, ParallelEnv

    from fbrl.envs import FootballEnv, FootballVectorEnv

    wrap = functools.partial(GymWrapper, categorical_action_encoding=True, device="cpu")
    make_one = functools.partial(FootballEnv, scenario, keys)
    if vectorisation == "single":
        return wrap(make_one())
    if vectorisation == "threads":
        return wrap(FootballVectorEnv(scenario, num_envs, observation_keys=keys))
    if vectorisation == "AsyncVectorEnv":
        return wrap(AsyncVectorEnv([make_one] * num_envs, autoreset_mode=AutoresetMode.DISABLED))
    return ParallelEnv(num_envs, functools.partial(_wrapped, wrap, make_one))


def _wrapped(wrap: Any, make_one: Any) -> Any:
    return wrap(make_one())
