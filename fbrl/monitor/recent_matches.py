"""Means over the matches that ended last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from fbrl.checks.counts import check_count
from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX
from fbrl.monitor.scalars import SCALARS
from fbrl.transforms import PLAY_STATISTICS

MATCHES_IN_MEAN = 100
"""Matches that the means take in; the environment's paper uses 100."""

_COUNT = "match/count"


class RecentMatches:
    """Takes the matches that ended out of each batch and keeps the figures of the latest ones.

    Args:
        reward_parts: Names of the reward's parts, as its transform gives them.

    Attributes:
        names: Of the means, as TensorBoard shows them, and of the number of matches.
    """

    def __init__(self, reward_parts: tuple[str, ...]) -> None:
        self._reward_keys = {"reward/total": EPISODE_PREFIX + "reward"} | {
            part.replace("reward_", "reward/", 1): EPISODE_PREFIX + part for part in reward_parts
        }
        # Checkpoints hold the figures in this order, which is that of the table of scalars.
        of_match = [name for name in SCALARS if name.startswith("match/") and name != _COUNT]
        of_play = [name for name in SCALARS if name.startswith("play/")]
        self.names = (*of_match, *self._reward_keys, *of_play, _COUNT)
        self._figures = np.empty((0, len(self.names) - 1))
        self._count = 0

    def add(self, batch: TensorDictBase) -> None:
        """Adds the matches that ended in a batch of shape (num_envs, num_steps)."""
        # In the order in which the matches ended: step by step, not match by match.
        following = batch.get("next").transpose(0, 1)
        ended = following.get("done").squeeze(-1)
        # Those that began in the middle are other matches.
        if (begun_midway := following.get("begun_midway", None)) is not None:
            ended = ended & ~begun_midway

        def at_the_end(key: str) -> Tensor:
            return following.get(key)[ended].to(torch.float64).squeeze(-1)

        goal_difference = at_the_end(EPISODE_PREFIX + "reward_scoring")
        play = dict(zip(PLAY_STATISTICS, at_the_end("play_statistics").unbind(-1), strict=True))
        figures = {
            "match/goal_difference": goal_difference,
            "match/goals_for": play["goals_for"],
            "match/goals_against": play["goals_against"],
            "match/win_share": (goal_difference > 0).double(),
            "match/draw_share": (goal_difference == 0).double(),
            "match/loss_share": (goal_difference < 0).double(),
            "match/length": at_the_end(EPISODE_LENGTH),
            **{name: at_the_end(key) for name, key in self._reward_keys.items()},
            "play/possession_share": play["possession"]
            / (play["possession"] + play["opponent_possession"]),
            "play/passes": play["passes"],
            "play/shots": play["shots"],
        }
        latest = torch.stack([figures[name] for name in self.names[:-1]], dim=-1).cpu().numpy()
        self._figures = np.concatenate([self._figures, latest])[-MATCHES_IN_MEAN:]
        self._count += len(latest)

    def state_dict(self) -> dict[str, Any]:
        """The figures of the latest matches, float64 of shape (matches, figures), and the count."""
        return {"figures": torch.from_numpy(self._figures), "count": self._count}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state.

        Raises:
            ValueError: The figures are others, or the count is none.
        """
        figures = state["figures"].numpy()
        if figures.ndim != 2 or figures.shape[1] != len(self.names) - 1:
            raise ValueError(f"figures of shape {figures.shape} for {len(self.names) - 1} names")
        self._figures = figures[-MATCHES_IN_MEAN:]
        self._count = check_count("count", state["count"], at_least=len(figures))

    def means(self) -> dict[str, float]:
        """The means by name, and how many matches have ended; nothing until one has.

        A figure that no match has, as the share of the possession where nobody ever had the ball,
        is left out.
        """
        if not self._count:
            return {}
        means = {
            name: float(values[~np.isnan(values)].mean())
            for name, values in zip(self.names[:-1], self._figures.T, strict=True)
            if not np.isnan(values).all()
        }
        return {**means, _COUNT: self._count}
