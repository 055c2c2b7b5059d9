"""The matches that a training learns from, wherever they are played."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from torchrl.envs import EnvBase

from fbrl.collect import make_collection_env
from fbrl.collect.collector import BatchCollector
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.config import TrainConfig
from fbrl.models.actor_critic import ActorCritic
from fbrl.transforms import ScoringReward

WORKER_TIMEOUT = 20
"""Seconds without an answer after which a process, or a Ray worker, that plays matches is replaced.
"""


@contextlib.contextmanager
def training_matches(
    config: TrainConfig,
    model: ActorCritic,
    reward: ScoringReward,
    on_warning: Callable[[str], None],
) -> Iterator[tuple[EnvBase | BatchCollector, EpisodeBookkeeping | None]]:
    """What :class:`fbrl.ppo.algorithm.PPO` collects from, closed with the context.

    Args:
        config: The training.
        model: Whose policy plays.
        reward: Labels the batches.
        on_warning: Called with one line when matches are lost.

    Raises:
        ConfigError: The Ray cluster that this process is connected to has no room for the matches.
    """
    worker_timeout = min(config.hang_timeout, WORKER_TIMEOUT)
    if config.collector == "ray":
        # It can't be imported where Ray is not installed.
        from fbrl.collect.ray_collector import RayMatchCollector

        policy = model.get_collection_policy()
        collector = RayMatchCollector(
            config,
            policy,
            reward,
            seed=config.seed,
            timeout=worker_timeout,
            on_restart=on_warning,
        )
        with contextlib.closing(collector):
            yield collector, None
        return
    env, bookkeeping = make_collection_env(
        config.scenario,
        num_envs=config.ppo.num_envs,
        reward=reward,
        observation=config.observation,
        num_threads=config.num_threads,
        collector=config.collector,
        num_workers=config.num_workers,
        worker_timeout=worker_timeout,
        on_restart=on_warning,
        seed=config.seed,
    )
    with contextlib.closing(env):
        yield env, bookkeeping
