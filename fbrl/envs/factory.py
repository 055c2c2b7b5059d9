"""Matches under TorchRL, assembled with a reward, an observation and sums per episode."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.data.utils import numpy_to_torch_dtype_dict
from torchrl.envs import (
    Compose,
    ExcludeTransform,
    GymWrapper,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from fbrl.components import OBSERVATIONS, REWARDS
from fbrl.envs.arguments import check_seed
from fbrl.envs.observation import OBSERVATION_SPACE, select_space
from fbrl.envs.vector_env import ActionSet, FootballVectorEnv
from fbrl.transforms import PLAY_STATISTICS, PlayStatistics, ScoringReward

EPISODE_PREFIX = "episode_"
"""``episode_reward``, ``episode_reward_scoring`` and so on: the sums over the episode so far."""

EPISODE_LENGTH = "step_count"
"""Steps of the episode so far."""


class FootballMatches(GymWrapper):
    """TorchRL's wrapper of a :class:`~fbrl.envs.FootballVectorEnv`, with a step of its own.

    The arrays of a step are what the specs promise and belong to the caller already, so the tensors
    share their memory; ``GymWrapper`` looks up and encodes each entry, which at 8 matches takes
    several times as long. Takes the arguments of ``GymWrapper``.

    Examples:
        >>> matches = FootballVectorEnv("academy_empty_goal", num_envs=2)
        >>> env = FootballMatches(matches, categorical_action_encoding=True, device="cpu")
        >>> env.rollout(3)["next", "ball"].shape
        torch.Size([2, 3, 3])
    """

    # TorchRL then repeats steps by a transform of its own, where its frame_skip is asked for.
    _has_frame_skip = False

    @property
    def matches(self) -> FootballVectorEnv:
        """The vector environment that is wrapped."""
        return self._env

    def _make_specs(self, *args: Any, **kwargs: Any) -> None:
        super()._make_specs(*args, **kwargs)
        # Whatever PyTorch's default is, rewards are what the matches write.
        shape = (*self.batch_size, 1)
        self.reward_spec = Unbounded(shape, dtype=torch.float32, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action", None)
        if action is None:
            raise KeyError(
                "There is no 'action' in the tensordict that is stepped, which has "
                f"{sorted(map(str, tensordict.keys()))}. A policy writes it, or "
                "env.rand_action(tensordict)."
            )
        observation, reward, terminated, truncated, info = self._env.step(action.numpy())
        results = {"reward": reward, "terminated": terminated, "truncated": truncated}
        results["done"] = terminated | truncated
        arrays = observation | {key: array[:, None] for key, array in results.items()}
        tensors = {key: torch.from_numpy(array) for key, array in arrays.items()}
        following = TensorDict(tensors, self.batch_size, device=self.device)
        for read in self.info_dict_reader:
            following = read(info, following)
        return following


def make_reward(
    reward: str | ScoringReward, *, gamma: float | None = None, **options: Any
) -> ScoringReward:
    """A reward transform from its name in :data:`fbrl.components.REWARDS` and its options.

    A transform is returned as it is. ``gamma`` is the training's discount, which some need.

    Raises:
        UnknownNameError: There is no reward of this name.
        ConfigError: It can't be imported, or has no such option.
        TypeError: It is neither a name nor a reward, or needs the discount.
    """
    if isinstance(reward, str):
        if reward == "potential" and gamma is None:
            raise TypeError(
                "The reward 'potential' needs the discount of the training: pass "
                "AssistDensityPotential(gamma=0.993), say, in place of its name."
            )
        reward = REWARDS.make(reward, options, gamma=gamma)
    if not isinstance(reward, ScoringReward):
        raise TypeError(
            f"The reward is {reward!r}; it must be a ScoringReward, or one of "
            f"{', '.join(REWARDS.names)}."
        )
    return reward


def make_observation(observation: str | Transform, **options: Any) -> Transform:
    """An observation transform, likewise from a name in :data:`fbrl.components.OBSERVATIONS`.

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
    raw = {
        key: Unbounded(space.shape, dtype=numpy_to_torch_dtype_dict[space.dtype])
        for key, space in OBSERVATION_SPACE.items()
    }
    return observation.transform_observation_spec(Composite(raw))[observed_key(observation)]


def make_env(
    scenario: str,
    *,
    num_envs: int = 8,
    reward: str | ScoringReward = "analytics",
    observation: str | Transform = "simple115",
    num_threads: int | None = None,
    action_set: ActionSet = "default",
    frame_skip: int = 1,
    keep_keys: Iterable[str] = (),
    seed: int | None = None,
) -> TransformedEnv:
    """Makes the vectorised environment that training and evaluation use.

    Args:
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        num_envs: Number of matches.
        reward: ``"analytics"``, ``"checkpoints"``, ``"scoring"``, or a transform of that family,
            such as ``AssistDensityReward(transition="consecutive")``; ``"potential"`` only as
            ``AssistDensityPotential(gamma=0.993)``, with the training's discount.
        observation: A name in :data:`fbrl.components.OBSERVATIONS`, or a transform.
        num_threads: As for :class:`FootballVectorEnv`, like the next two.
        action_set: ``"default"`` or ``"v2"``.
        frame_skip: Steps of gfootball for each action.
        keep_keys: Raw observation keys to keep; the others are dropped once the reward and the
            observation are computed, so that a collector neither copies nor stores them.
        seed: Seeds the matches.

    Returns:
        An environment on the CPU with batch size (num_envs,) that writes the observation,
        ``reward`` and its parts, for each of these an ``episode_`` sum, ``step_count``, and
        ``play_statistics``.

    Raises:
        ValueError: A name, or a key to keep, is unknown, or a number is out of range.
        EngineNotInstalledError: gfootball is missing.

    Examples:
        >>> env = make_env("academy_empty_goal", num_envs=2, reward="scoring", seed=0)
        >>> env.rollout(3)["next", "episode_reward_scoring"].shape
        torch.Size([2, 3, 1])
    """
    reward = make_reward(reward)
    transforms = [reward, make_observation(observation), PlayStatistics()]
    raw_keys = raw_keys_of(transforms)
    kept = set(select_space(keep_keys))
    if seed is not None:
        check_seed(seed)
    matches = FootballVectorEnv(
        scenario,
        num_envs,
        num_threads,
        observation_keys=raw_keys | kept,
        action_set=action_set,
        frame_skip=frame_skip,
    )
    sums = ["reward", *reward.part_names]
    env = TransformedEnv(
        FootballMatches(matches, categorical_action_encoding=True, device="cpu"),
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


def figures_of_matches(
    ends: TensorDictBase, reward_names: Iterable[str], frame_skip: int = 1
) -> dict[str, Tensor]:
    """What there is to tell of matches that have ended, each float64 of shape (matches,).

    Args:
        ends: What their last steps led to, shape (matches,).
        reward_names: Of the reward and its parts, whose sums over the match are told, too.
        frame_skip: Of the matches.

    Returns:
        ``goal_difference``, ``goals_for``, ``goals_against``, ``length`` (frames; a step that the
        end cuts off counts as a whole), ``possession_share`` (of the steps after which somebody had
        the ball; NaN where nobody ever had), ``passes``, ``shots``, and the sums by the names of
        the rewards.
    """
    totals = ends.get("play_statistics").to(torch.float64)
    play = dict(zip(PLAY_STATISTICS, totals.unbind(-1), strict=True))
    sums = {name: ends.get(EPISODE_PREFIX + name).double().squeeze(-1) for name in reward_names}
    return {
        "goal_difference": play["goals_for"] - play["goals_against"],
        "goals_for": play["goals_for"],
        "goals_against": play["goals_against"],
        "length": ends.get(EPISODE_LENGTH).double().squeeze(-1) * frame_skip,
        "possession_share": play["possession"] / (play["possession"] + play["opponent_possession"]),
        "passes": play["passes"],
        "shots": play["shots"],
        **sums,
    }


def raw_keys_of(transforms: Iterable[Transform]) -> set[str]:
    """What the transforms read of a match's raw observation."""
    keys: set[Any] = set()
    for transform in transforms:
        is_composed = isinstance(transform, Compose)
        keys |= raw_keys_of(transform) if is_composed else set(transform.in_keys)
    return keys & set(OBSERVATION_SPACE)
