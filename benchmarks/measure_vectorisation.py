"""Collection of experience with a small network, by several ways to step many matches."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable
from typing import Any

VECTORISATIONS = ("threads", "MultiSyncCollector", "ParallelEnv", "AsyncVectorEnv")
"""fbrl's own; TorchRL's processes, that collect or only step; Gymnasium's."""

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

    from fbrl.collect import MatchCollector, RolloutCollector
    from fbrl.models.actor_critic import build_actor_critic

    # Spawned processes would import everything for seconds each; once they run there is no
    # difference.
    torch.multiprocessing.set_start_method("fork", force=True)
    torch.manual_seed(seed)
    model = build_actor_critic("simple115", activation="relu")
    collect_batch: Callable[[], Any]
    with contextlib.ExitStack() as stack:
        if vectorisation == "MultiSyncCollector":
            collector = _make_multi_sync_collector(scenario, num_envs, model)
            stack.callback(collector.shutdown)
            collect_batch = functools.partial(next, iter(collector))
        else:
            policy = model.get_collection_policy()
            ours: MatchCollector | RolloutCollector
            if vectorisation == "threads":
                ours = MatchCollector(
                    scenario, policy, num_envs=num_envs, num_steps=_STEPS_PER_BATCH
                )
            else:
                env = _make_env(scenario, vectorisation, num_envs)
                ours = RolloutCollector(env, policy, _STEPS_PER_BATCH)
            stack.callback(ours.close)
            collect_batch = ours.collect
        return {"frames_per_second": frames_per_second(collect_batch, seconds)}


def frames_per_second(collect_batch: Callable[[], Any], seconds: float) -> float:
    """Frames that batches have in a second, after the first batch."""
    collect_batch()
    frames = 0
    started = time.perf_counter()
    while time.perf_counter() - started < seconds:
        frames += collect_batch().numel()
    return frames / (time.perf_counter() - started)


def _make_multi_sync_collector(scenario: str, num_envs: int, model: Any) -> Any:
    from torchrl.collectors import MultiSyncCollector

    return MultiSyncCollector(
        [functools.partial(_make_env, scenario, "single", 1)] * num_envs,
        model.get_collection_policy(),
        frames_per_batch=num_envs * _STEPS_PER_BATCH,
        total_frames=-1,
        trust_policy=True,
        auto_register_policy_transforms=False,
        cat_results="stack",
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

    from fbrl.envs import FootballEnv

    wrap = functools.partial(GymWrapper, categorical_action_encoding=True, device="cpu")
    make_one = functools.partial(FootballEnv, scenario, keys)
    if vectorisation == "single":
        return wrap(make_one())
    if vectorisation == "AsyncVectorEnv":
        return wrap(AsyncVectorEnv([make_one] * num_envs, autoreset_mode=AutoresetMode.DISABLED))
    return ParallelEnv(num_envs, functools.partial(_wrapped, wrap, make_one))


def _wrapped(wrap: Any, make_one: Any) -> Any:
    return wrap(make_one())
