"""Assembles a training environment: matches, reward, observation, sums per episode."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tensordict import NestedKey
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.data.utils import numpy_to_torch_dtype_dict
from torchrl.envs import (
    Compose,
    ExcludeTransform,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from fbrl.components import OBSERVATIONS, REWARDS
from fbrl.envs.episode_seeds import check_seed
from fbrl.envs.observation import OBSERVATION_SPACE, select_space
from fbrl.envs.torchrl_matches import FootballMatches
from fbrl.envs.vector_env import ActionSet, FootballVectorEnv
from fbrl.transforms import PlayStatistics, ScoringReward

EPISODE_PREFIX = "episode_"
"""``episode_reward``, ``episode_reward_scoring`` and so on: the sums over the episode so far."""

EPISODE_LENGTH = "step_count"
"""Steps of the episode so far."""


def make_reward(
    reward: str | ScoringReward, *, gamma: float | None = None, **options: Any
) -> ScoringReward:
    """A reward transform from its name and options; a transform is returned as it is.

    Args:
        reward: A name in :data:`fbrl.components.REWARDS`, or a transform.
        gamma: The training's discount, for those that need it.
        options: The reward's own.

    Raises:
        UnknownNameError: There is no reward of this name.
        ConfigError: It can't be imported, or has no such option.
        TypeError: It is neither a name nor a reward, or needs the discount.
    """
    if not isinstance(reward, str):
        return _checked(reward)
    if reward == "potential" and gamma is None:
        raise TypeError(
            "The reward 'potential' needs the discount of the training: pass "
            "AssistDensityPotential(gamma=0.993), say, in place of its name."
        )
    return _checked(REWARDS.make(reward, options, gamma=gamma))


def _checked(reward: Any) -> ScoringReward:
    if not isinstance(reward, ScoringReward):
        raise TypeError(
            f"The reward is {reward!r}; it must be a ScoringReward, or one of "
            f"{', '.join(REWARDS.names)}."
        )
    return reward


def make_observation(observation: str | Transform, **options: Any) -> Transform:
    """An observation transform from its name and options; a transform is returned as it is.

    Args:
        observation: A name in :data:`fbrl.components.OBSERVATIONS`, or a transform.
        options: The observation's own.

    Raises:
        UnknownNameError: There is no observation of this name.
        ConfigError: It can't be imported, or has no such option.
        TypeError: It is neither a name nor a transform.
    """
    if isinstance(observation, str):
        observation = OBSERVATIONS.make(observation, options)
    if not isinstance(observation, Transform) or isinstance(observation, ScoringReward):
        raise TypeError(
            f"The observation is {observation!r}; it must be a Transform that writes one, or one "
            f"of {', '.join(OBSERVATIONS.names)}."
        )
    return observation


def observed_key(observation: Transform) -> NestedKey:
    """What a network reads: the last entry that an observation writes."""
    last = observation[-1] if isinstance(observation, Compose) else observation
    return last.out_keys[-1]


def observed_spec(observation: Transform) -> TensorSpec:
    """The spec of what a network reads, of a single match."""
    raw = Composite(
        {
            key: Unbounded(space.shape, dtype=numpy_to_torch_dtype_dict[space.dtype])
            for key, space in OBSERVATION_SPACE.items()
        }
    )
    return observation.transform_observation_spec(raw)[observed_key(observation)]


def make_env(
    scenario: str,
    *,
    num_envs: int = 8,
    reward: str | ScoringReward = "analytics",
    observation: str | Transform = "simple115",
    num_threads: int | None = None,
    action_set: ActionSet = "default",
    keep_keys: Iterable[str] = (),
    seed: int | None = None,
) -> TransformedEnv:
    """Makes the vectorised environment that training and evaluation use.

    Args:
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        num_envs: Number of matches, the batch size of the environment.
        reward: ``"analytics"``, ``"checkpoints"``, ``"scoring"``, or a transform of that family,
            such as ``AssistDensityReward(transition="consecutive")``; ``"potential"`` only as
            ``AssistDensityPotential(gamma=0.993)``, with the training's discount.
        observation: A name in :data:`fbrl.components.OBSERVATIONS`, or a transform.
        num_threads: Threads that step the matches; one for each available core by default.
        action_set: ``"default"`` (19 actions), or ``"v2"`` with the engine's own player as a 20th.
        keep_keys: Raw observation keys to keep; the others are dropped once the reward and the
            observation are computed, so that a collector neither copies nor stores them.
        seed: Seeds the matches.

    Returns:
        An environment on the CPU with batch size (num_envs,) that writes the observation,
        ``reward`` and its parts, for each of these an ``episode_`` sum, ``step_count``, and
        ``play_statistics``.

    Raises:
        ValueError: A name, or a key to keep, is unknown, or a number is out of range.
        TypeError: An argument is of another type.
        EngineNotInstalledError: gfootball is missing.

    Examples:
        >>> env = make_env("academy_empty_goal", num_envs=2, reward="scoring", seed=0)
        >>> env.rollout(3)["next", "episode_reward_scoring"].shape
        torch.Size([2, 3, 1])
    """
    reward_transform = make_reward(reward)
    transforms = [reward_transform, make_observation(observation), PlayStatistics()]
    raw_keys = raw_keys_of(transforms)
    kept = set(select_space(keep_keys))
    if seed is not None:
        check_seed(seed)
    matches = FootballVectorEnv(
        scenario, num_envs, num_threads, observation_keys=raw_keys | kept, action_set=action_set
    )
    sums = ["reward", *reward_transform.part_names]
    env = TransformedEnv(
        as_torchrl(matches),
        Compose(
            *transforms,
            RewardSum(in_keys=sums, out_keys=[EPISODE_PREFIX + name for name in sums]),
            StepCounter(step_count_key=EPISODE_LENGTH),
            ExcludeTransform(*sorted(raw_keys - kept)),
        ),
    )
    if seed is not None:
        env.set_seed(seed)
    return env


def as_torchrl(matches: FootballVectorEnv) -> FootballMatches:
    """The matches as TorchRL's environment on the CPU, with actions as integers."""
    return FootballMatches(matches, categorical_action_encoding=True, device="cpu")


def raw_keys_of(transforms: Iterable[Transform]) -> set[str]:
    """What the transforms read of a match's raw observation."""
    keys: set[Any] = set()
    for transform in transforms:
        is_composed = isinstance(transform, Compose)
        keys |= raw_keys_of(transform) if is_composed else set(transform.in_keys)
    return keys & set(OBSERVATION_SPACE)
