"""Collection of experience with a small network: alone, vectorised in several ways, on many cores.

Many cores are more than there are: an engine that sleeps leaves the real ones to the rest. What a
step would compute takes no core, only its time. So as many threads as are asked for behave as so
many cores, except that what is left to do, Python, the network and waking the threads, has to share
the few real ones.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable
from typing import Any

VECTORISATIONS = ("threads", "MultiSyncCollector", "ParallelEnv", "AsyncVectorEnv")
"""fbrl's own; TorchRL's processes, that collect or only step; Gymnasium's."""

_STEPS_PER_BATCH = 16

STEP_SECONDS, SPREAD = 0.002, 0.001
"""A step sleeps between 1 and 3 ms, as engines take."""

RESET_SECONDS, STEPS_PER_RESET = 0.0015, 100
"""One step in so many takes longer, by the time of a reset."""

GPU_SECONDS = 0.001
"""What a network on a GPU takes to answer, with transfers."""


def collect(
    scenario: str, vectorisation: str, num_envs: int, seconds: float, seed: int
) -> dict[str, float]:
    """Collects with the light preset's network, its observation and the analytics reward.

    Returns:
        ``frames_per_second`` after the first batch, resets of matches included.
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


def fbrl_collection(scenario: str, num_envs: int, seconds: float, seed: int) -> dict[str, float]:
    """Collects as a training of the preset light does, without learning.

    Returns:
        ``frames_per_second`` after the first batch, resets of matches included.
    """
    import torch

    from fbrl.assembly import make_model
    from fbrl.collect import MatchCollector
    from fbrl.presets import preset_config

    torch.manual_seed(seed)
    config = preset_config("light", scenario)
    collector = MatchCollector(
        scenario,
        make_model(config, torch.device("cpu")).get_collection_policy(),
        num_envs=num_envs,
        reward=config.reward,
        observation=config.observation,
        seed=seed,
    )
    rate = frames_per_second(collector.collect, seconds)
    collector.close()
    return {"frames_per_second": rate}


def share_of_sleeping_engines(
    cores: int, network: str, matches_per_core: int, seconds: float, seed: int
) -> dict[str, float]:
    """Collects with the preset light's network, or one that sleeps as if it were on a GPU.

    ``cores`` is the number of threads whose steps sleep, and ``network`` ``"mlp"`` or ``"gpu"``.

    Returns:
        ``frames_per_second``, and their ``share`` of what the threads could do asleep alone.
    """
    import torch

    from fbrl.collect import MatchCollector
    from fbrl.envs.engine import load_gfootball
    from fbrl.models.actor_critic import build_actor_critic

    torch.manual_seed(seed)
    policy = build_actor_critic("simple115").get_collection_policy()
    if network == "gpu":
        policy.trunk.register_forward_hook(lambda *_: time.sleep(GPU_SECONDS))
    collector = MatchCollector(
        "academy_3_vs_1_with_keeper",
        policy,
        num_envs=matches_per_core * cores,
        num_steps=64,
        num_threads=cores,
        seed=seed,
    )
    collector.reset()
    sleep: Any = load_gfootball().engine.Disturbance(
        "sleep",
        seconds=STEP_SECONDS,
        spread=SPREAD,
        reset_seconds=RESET_SECONDS,
        steps_per_reset=STEPS_PER_RESET,
    )
    collector.disturb(sleep)
    rate = frames_per_second(collector.collect, seconds)
    collector.close()
    bare = cores / (STEP_SECONDS + RESET_SECONDS / STEPS_PER_RESET)
    return {"frames_per_second": rate, "share": rate / bare}


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
    return ParallelEnv(num_envs, lambda: wrap(make_one()))
