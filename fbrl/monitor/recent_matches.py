"""Means over the matches that ended last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from fbrl.checks import check_count
from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX, figures_of_matches
from fbrl.monitor.scalars import SCALARS

MATCHES_IN_MEAN = 100
"""Matches that the means take in; the environment's paper uses 100."""

_COUNT = "match/count"


class RecentMatches:
    """Takes the matches that ended out of each batch and keeps the figures of the latest ones.

    Args:
        reward_parts: Names of the reward's parts, as its transform gives them.
        frame_skip: Of the matches.

    Attributes:
        names: Of the means, as TensorBoard shows them, and of the number of matches.
    """

    def __init__(self, reward_parts: tuple[str, ...], frame_skip: int = 1) -> None:
        self._frame_skip = frame_skip
        rewards = {"reward/total": "reward"} | {
            part.replace("reward_", "reward/", 1): part for part in reward_parts
        }
        # Checkpoints hold the figures in this order, which is that of the table of scalars.
        of_match = [name for name in SCALARS if name.startswith("match/") and name != _COUNT]
        of_play = [name for name in SCALARS if name.startswith("play/")]
        self._rewards = tuple(rewards.values())
        self._figure_of = {
            name: rewards.get(name, name.partition("/")[2])
            for name in (*of_match, *rewards, *of_play)
        }
        self.names = (*self._figure_of, _COUNT)
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

        sums = [EPISODE_PREFIX + name for name in self._rewards]
        told = following.select("play_statistics", EPISODE_LENGTH, *sums)
        figures = figures_of_matches(told[ended], self._rewards, self._frame_skip)
        difference = figures["goal_difference"]
        figures["win_share"] = (difference > 0).double()
        figures["draw_share"] = (difference == 0).double()
        figures["loss_share"] = (difference < 0).double()
        columns = [figures[figure] for figure in self._figure_of.values()]
        latest = torch.stack(columns, -1).cpu().numpy()
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
