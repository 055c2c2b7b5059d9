"""Fresh matches of a policy, and the goal difference with its interval."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import stats
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type

from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Evaluation:
    """Results of single matches.

    Attributes:
        goal_differences: Goals for minus goals against of each match, shape (episodes,).
        lengths: Steps of each match, shape (episodes,).
    """

    goal_differences: np.ndarray
    lengths: np.ndarray

    @property
    def goal_difference(self) -> float:
        """The mean over the matches."""
        return float(self.goal_differences.mean())

    @functools.cached_property
    def interval(self) -> tuple[float, float]:
        """Bounds of the mean's 95 % interval: percentile bootstrap, the same at each call."""
        values = self.goal_differences
        if len(values) < 2 or values.min() == values.max():
            return self.goal_difference, self.goal_difference
        result = stats.bootstrap(
            (values,),
            np.mean,
            confidence_level=CONFIDENCE,
            n_resamples=9999,
            # Limits the memory, which would otherwise grow with the number of matches.
            batch=100,
            method="percentile",
            rng=np.random.default_rng(0),
        )
        return float(result.confidence_interval.low), float(result.confidence_interval.high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{self.goal_difference:.3f} [{low:.3f}, {high:.3f}] over "
            f"{len(self.goal_differences)} matches"
        )


@torch.no_grad()
def evaluate(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    episodes: int,
    *,
    greedy: bool = False,
    device: torch.device | str = "cpu",
    on_progress: Callable[[int], None] | None = None,
) -> Evaluation:
    """Plays matches to their end.

    Every place of the vectorised environment plays the same number of matches (an even number,
    so that either side kicks off equally often): taking the first that end would favour short
    ones.

    Args:
        env: A vectorised environment of :func:`fbrl.envs.make_env`, seeded by the caller.
        policy: Reads the observation and writes ``action``.
        episodes: How many matches at least; rounded up to a multiple of 2 * num_envs.
        greedy: Take the most probable action instead of sampling.
        device: Where the policy runs.
        on_progress: Called with the number of matches finished so far.
    """
    num_envs = env.batch_size[0]
    quota = 2 * math.ceil(episodes / (2 * num_envs))
    finished: list[list[tuple[float, int]]] = [[] for _ in range(num_envs)]
    exploration = ExplorationType.DETERMINISTIC if greedy else ExplorationType.RANDOM
    with set_exploration_type(exploration):
        state = env.reset()
        while any(len(matches) < quota for matches in finished):
            state = policy(state.to(device)).to(env.device)
            step, state = env.step_and_maybe_reset(state)
            following = step.get("next")
            for index in following.get("done").squeeze(-1).nonzero().squeeze(-1).tolist():
                match = following[index]
                goals = match.get(EPISODE_PREFIX + "reward_scoring").item()
                if len(finished[index]) < quota:
                    finished[index].append((goals, match.get(EPISODE_LENGTH).item()))
            if on_progress is not None:
                on_progress(sum(len(matches) for matches in finished))
    results = np.array([match for matches in finished for match in matches])
    return Evaluation(results[:, 0], results[:, 1].astype(int))
