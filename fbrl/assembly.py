"""Where a configuration becomes matches, transforms, a network and a collector.

Training, evaluation, watching and Ray's workers all make theirs here.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import Compose, Transform, TransformedEnv

from fbrl.collect import AheadCollector, BatchCollector, MatchCollector
from fbrl.components import MASKS
from fbrl.config import TrainConfig
from fbrl.envs.factory import make_env, make_observation, make_reward
from fbrl.models.actor_critic import ActorCritic, CollectionPolicy, build_actor_critic
from fbrl.registry import ConfigError
from fbrl.run_files import DENSITY_NAME
from fbrl.transforms import ScoringReward

WORKER_TIMEOUT = 20
"""Seconds without an answer after which a Ray worker that plays matches is replaced."""


@contextlib.contextmanager
def _stating_what_cannot_be_made() -> Iterator[None]:
    """Makes a :class:`ConfigError` of what a configuration's components refuse."""
    try:
        yield
    except (ValueError, TypeError, OSError) as error:
        raise ConfigError(str(error)) from error


def make_training_reward(config: TrainConfig, run_dir: Path | None = None) -> ScoringReward:
    """The reward that a configuration asks for.

    The densities that the directory of its run keeps are taken instead of those that the
    configuration names, which may have changed since.

    Raises:
        ConfigError: It can't be made: its density can't be read, say.
    """
    options = dict(config.reward_options)
    if run_dir is not None and (run_dir / DENSITY_NAME).is_file():
        options["density"] = run_dir / DENSITY_NAME
    with _stating_what_cannot_be_made():
        return make_reward(config.reward, gamma=config.ppo.gamma, **options)


def keep_density(reward: ScoringReward, run_dir: Path) -> None:
    """Keeps the densities of a reward, if it has any, with its run."""
    if reward.density is not None:
        reward.density.save(run_dir / DENSITY_NAME)


def make_agent_observation(config: TrainConfig) -> Transform:
    """What the agent of a configuration looks at, its action mask included."""
    with _stating_what_cannot_be_made():
        observation = make_observation(config.observation, **config.observation_options)
        if config.mask is None:
            return observation
        return Compose(observation, MASKS.make(config.mask, config.mask_options))


def make_model(config: TrainConfig, device: torch.device) -> ActorCritic:
    """The network that a configuration asks for, with fresh weights.

    Raises:
        ConfigError: It can't be made, or can't read the observation.
    """
    with _stating_what_cannot_be_made():
        return build_actor_critic(
            make_observation(config.observation, **config.observation_options),
            config.network_name,
            is_mirrored=config.mirror,
            is_masked=config.mask is not None,
            device=device,
            **config.network_options,
        )


def make_agent_env(config: TrainConfig, **options: Any) -> TransformedEnv:
    """Matches for the agent of a configuration, with the options of :func:`fbrl.envs.make_env`."""
    observation, frame_skip = make_agent_observation(config), config.ppo.frame_skip
    return make_env(config.scenario, observation=observation, frame_skip=frame_skip, **options)


def make_collector(
    config: TrainConfig,
    policy: CollectionPolicy,
    reward: ScoringReward,
    on_warning: Callable[[str], None],
) -> BatchCollector:
    """Makes what :class:`fbrl.ppo.algorithm.PPO` learns from.

    Where matches are lost, ``on_warning`` is called with one line.

    Raises:
        ConfigError: This machine, or the Ray cluster that this process is connected to, has no room
            for the matches.
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

    in_this_process = functools.partial(
        MatchCollector,
        config.scenario,
        num_envs=config.ppo.num_envs,
        num_steps=config.ppo.num_steps,
        reward=reward,
        observation=make_agent_observation(config),
        num_threads=config.num_threads,
        frame_skip=config.ppo.frame_skip,
        num_groups=config.num_groups,
        midway_starts=config.midway_starts,
        seed=config.seed,
    )
    try:
        if config.collect_ahead:
            return AheadCollector(in_this_process, policy)
        return in_this_process(policy)
    except ValueError as error:
        raise ConfigError(str(error)) from error
