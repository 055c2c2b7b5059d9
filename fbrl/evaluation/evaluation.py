"""Fresh matches of a policy: goals, possession, passes, shots and rewards, with intervals."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type

from fbrl.checks import check_count
from fbrl.envs.factory import figures_of_matches

Policy = Callable[[TensorDictBase], TensorDictBase]


@dataclass(frozen=True)
class Evaluation:
    """Figures of single matches, and their means with intervals.

    Attributes:
        matches: An array of shape (episodes,) for each figure: ``goal_difference``,
            ``goals_for``, ``goals_against``, ``length`` (frames), ``possession_share`` (of the
            steps after which somebody had the ball; NaN where nobody ever had), ``passes``,
            ``shots``, ``reward`` and each of its parts (sums over the match), such as
            ``reward_scoring``.
    """

    matches: Mapping[str, np.ndarray]

    @property
    def goal_differences(self) -> np.ndarray:
        """Goals for minus goals against of each match."""
        return self.matches["goal_difference"]

    @property
    def results(self) -> tuple[int, int, int]:
        """How many matches were won, drawn and lost."""
        goals = self.goal_differences
        return int((goals > 0).sum()), int((goals == 0).sum()), int((goals < 0).sum())

    def mean(self, figure: str) -> float:
        """The mean over the matches that have the figure; NaN if none has."""
        values = self._values(figure)
        return float(values.mean()) if len(values) else math.nan

    def mean_interval(self, figure: str) -> tuple[float, float]:
        """Bounds of the mean's 95 % interval: percentile bootstrap, the same at each call."""
        values, mean = self._values(figure), self.mean(figure)
        if len(values) < 2 or values.min() == values.max():
            return mean, mean
        # Most of a second, which a training need not wait for before its first match.
        from scipy import stats

        # In batches, as the memory would otherwise grow with the number of matches.
        result = stats.bootstrap(
            (values,), np.mean, batch=100, method="percentile", rng=np.random.default_rng(0)
        )
        return float(result.confidence_interval.low), float(result.confidence_interval.high)

    @property
    def goal_difference(self) -> float:
        """The mean over the matches."""
        return self.mean("goal_difference")

    @functools.cached_property
    def interval(self) -> tuple[float, float]:
        """Bounds of the 95 % interval of the mean goal difference."""
        return self.mean_interval("goal_difference")

    def _values(self, figure: str) -> np.ndarray:
        values = self.matches[figure]
        return values[~np.isnan(values)]

    def __str__(self) -> str:
        (low, high), matches = self.interval, len(self.goal_differences)
        return f"{self.goal_difference:.3f} [{low:.3f}, {high:.3f}] over {matches} matches"


def evaluate(
    env: EnvBase,
    policy: Policy,
    episodes: int,
    *,
    greedy: bool = False,
    device: torch.device | str = "cpu",
    on_progress: Callable[[int], None] | None = None,
    on_step: Callable[[TensorDictBase, torch.Tensor], None] | None = None,
) -> Evaluation:
    """Plays matches to their end, see :func:`play_matches`.

    Args:
        env: A vectorised environment of :func:`fbrl.envs.make_env`, seeded by the caller.
        policy: Reads the observation and writes ``action``.
        episodes: How many matches at least.
        greedy: Take the most probable action instead of sampling.
        device: Where the policy runs.
        on_progress: Called with the number of matches finished so far.
        on_step: Called with what :func:`play_matches` yields.

    Raises:
        ValueError: No match is asked for, or the actions are none.
        TypeError: The number of matches is no integer, or the environment or the policy is none.
    """
    figures: list[dict[str, torch.Tensor]] = []
    num_ended = 0
    for following, counted in play_matches(env, policy, episodes, greedy=greedy, device=device):
        if on_step is not None:
            on_step(following, counted)
        ended = following.get("done").squeeze(-1) & counted
        if ended.any():
            figures.append(
                figures_of_matches(following[ended], env.reward_keys, env.matches.frame_skip)
            )
            num_ended += int(ended.sum())
        if on_progress is not None:
            on_progress(num_ended)
    matches = {name: torch.cat([ends[name] for ends in figures]) for name in figures[0]}
    return Evaluation({name: values.cpu().numpy() for name, values in matches.items()})


@torch.no_grad()
def play_matches(
    env: EnvBase,
    policy: Policy,
    episodes: int,
    *,
    greedy: bool = False,
    device: torch.device | str = "cpu",
) -> Iterator[tuple[TensorDictBase, torch.Tensor]]:
    """Plays until every place of the environment has finished its share of the matches.

    Every place plays the same number of matches: taking the first that end would favour short
    ones. It is an even number, so that either side kicks off equally often: ``episodes`` is rounded
    up to a multiple of 2 * num_envs. The arguments are those of :func:`evaluate`.

    Yields:
        What each step led to, of shape (num_envs,), and which places were still playing a match of
        their share, boolean of shape (num_envs,).

    Raises:
        ValueError: No match is asked for, or the actions are none.
        TypeError: The number of matches is no integer, or the environment or the policy is none.
    """
    if not isinstance(env, EnvBase) or len(env.batch_size) != 1:
        raise TypeError(
            f"The environment is a {type(env).__name__}; it must be one of fbrl.envs.make_env."
        )
    episodes, num_envs = check_count("episodes", episodes), env.batch_size[0]
    left = torch.full((num_envs,), 2 * math.ceil(episodes / (2 * num_envs)))
    exploration = ExplorationType.DETERMINISTIC if greedy else ExplorationType.RANDOM
    state = env.reset()
    while (left > 0).any():
        with set_exploration_type(exploration):
            state = policy(state.to(device))
        if not isinstance(state, TensorDictBase):
            raise TypeError(f"The policy returned {state!r}; it must return its tensordict.")
        state = state.to(env.device)
        step, state = env.step_and_maybe_reset(state)
        following, counted = step.get("next"), left > 0
        yield following, counted
        left -= (following.get("done").squeeze(-1) & counted).long()
