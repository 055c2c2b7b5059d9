"""The matches that a training learns from, wherever they are played."""

from __future__ import annotations

from collections.abc import Callable

from fbrl.agent import make_agent_observation
from fbrl.collect import AheadCollector, BatchCollector, MatchCollector
from fbrl.config import TrainConfig
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.transforms import ScoringReward

WORKER_TIMEOUT = 20
"""Seconds without an answer after which a Ray worker that plays matches is replaced."""


def make_collector(
    config: TrainConfig,
    policy: CollectionPolicy,
    reward: ScoringReward,
    on_warning: Callable[[str], None],
) -> BatchCollector:
    """Makes what :class:`fbrl.ppo.algorithm.PPO` learns from.

    Args:
        config: The training.
        policy: Plays.
        reward: Labels the batches.
        on_warning: Called with one line when matches are lost.

    Raises:
        ConfigError: The Ray cluster that this process is connected to has no room for the matches.
    """
    if config.collector == "ray":
        # It can't be imported where Ray is not installed.
        from fbrl.collect.ray_collector import RayMatchCollector

        return RayMatchCollector(
            config,
            policy,
            reward,
            seed=config.seed,
            timeout=min(config.hang_timeout, WORKER_TIMEOUT),
            on_restart=on_warning,
        )

    def in_this_process(policy: CollectionPolicy) -> MatchCollector:
        return MatchCollector(
            config.scenario,
            policy,
            num_envs=config.ppo.num_envs,
            num_steps=config.ppo.num_steps,
            reward=reward,
            observation=make_agent_observation(config),
            num_threads=config.num_threads,
            num_groups=config.num_groups,
            seed=config.seed,
        )

    if not config.collect_ahead:
        return in_this_process(policy)
    return AheadCollector(in_this_process, policy)
