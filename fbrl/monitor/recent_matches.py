"""Means over the matches that ended last."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from fbrl.checks.counts import check_count
from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX
from fbrl.transforms import PLAY_STATISTICS

MATCHES_IN_MEAN = 100
"""Matches that the means take in; the environment's paper uses 100."""


class RecentMatches:
    """Takes the matches that ended out of each batch and keeps the figures of the latest ones.

    Args:
        reward_parts: Names of the reward's parts, as its transform gives them.

    Attributes:
        names: Of the means, as TensorBoard shows them, and of the number of matches.
    """

    def __init__(self, reward_parts: tuple[str, ...]) -> None:
        self._reward_keys = {"reward/total": EPISODE_PREFIX + "reward"}
        for part in reward_parts:
            name = part.replace("reward_", "reward/", 1)
            self._reward_keys[name] = EPISODE_PREFIX + part
        self.names = (
            "match/goal_difference",
            "match/goals_for",
            "match/goals_against",
            "match/win_share",
            "match/draw_share",
            "match/loss_share",
            "match/length",
            *self._reward_keys,
            "play/possession_share",
            "play/passes",
            "play/shots",
            "match/count",
        )
        self._figures: deque[np.ndarray] = deque(maxlen=MATCHES_IN_MEAN)
        self._count = 0

    def add(self, batch: TensorDictBase) -> None:
        """Adds the matches that ended in a batch of shape (num_envs, num_steps)."""
        following = batch.get("next")
        # In the order in which the matches ended: step by step, not match by match.
        ended = following.get("done").squeeze(-1).transpose(0, 1)
        # Those that began in the middle are other matches.
        if (begun_midway := following.get("begun_midway", None)) is not None:
            ended = ended & ~begun_midway.transpose(0, 1)

        def at_the_end(key: str) -> Tensor:
            return following.get(key).transpose(0, 1)[ended].to(torch.float64)

        goal_difference = at_the_end(EPISODE_PREFIX + "reward_scoring").squeeze(-1)
        play = dict(zip(PLAY_STATISTICS, at_the_end("play_statistics").unbind(-1), strict=True))
        in_possession = play["possession"] + play["opponent_possession"]
        figures = torch.stack(
            [
                goal_difference,
                play["goals_for"],
                play["goals_against"],
                (goal_difference > 0).double(),
                (goal_difference == 0).double(),
                (goal_difference < 0).double(),
                at_the_end(EPISODE_LENGTH).squeeze(-1),
                *(at_the_end(key).squeeze(-1) for key in self._reward_keys.values()),
                play["possession"] / in_possession,
                play["passes"],
                play["shots"],
            ],
            dim=-1,
        )
        self._figures.extend(figures.cpu().numpy())
        self._count += len(figures)

    def state_dict(self) -> dict[str, Any]:
        """The figures of the latest matches, float64 of shape (matches, figures), and the count."""
        figures = np.array(self._figures).reshape(len(self._figures), len(self.names) - 1)
        return {"figures": torch.from_numpy(figures), "count": self._count}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state.

        Raises:
            ValueError: The figures are others, or the count is none.
        """
        figures = state["figures"].numpy()
        if figures.ndim != 2 or figures.shape[1] != len(self.names) - 1:
            raise ValueError(f"figures of shape {figures.shape} for {len(self.names) - 1} names")
        self._figures.clear()
        self._figures.extend(figures)
        self._count = check_count("count", state["count"], at_least=len(figures))

    def means(self) -> dict[str, float]:
        """The means by name, and how many matches have ended; nothing until one has.

        A figure that no match has, as the share of the possession where nobody ever had the ball,
        is left out.
        """
        if not self._count:
            return {}
        columns = np.array(self._figures).T
        means = {
            name: float(values[~np.isnan(values)].mean())
            for name, values in zip(self.names[:-1], columns, strict=True)
            if not np.isnan(values).all()
        }
        return {**means, "match/count": self._count}
