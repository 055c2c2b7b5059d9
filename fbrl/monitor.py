"""What is logged while training: every TensorBoard name, and the files of a run.

====================================  ==============================================================
name                                  meaning
====================================  ==============================================================
``match/goal_difference``             goals for minus goals against, mean of the last 100 matches
``match/length``                      steps of a match, mean of the last 100 matches
``match/count``                       matches finished since the start
``reward/total``                      sum over a match of what PPO maximises, likewise
``reward/scoring``                    its part from goals
``reward/start_density``              its part from where assists start (analytics)
``reward/end_density``                its part from where assists end (analytics)
``reward/checkpoint``                 its part from checkpoints (checkpoints)
``ppo/policy_loss``                   clipped surrogate
``ppo/value_loss``                    weighted squared error of the critic
``ppo/entropy``                       of the policy, in nats; ln 19 = 2.94 is uniform
``ppo/approx_kl``                     estimated divergence of the new policy from the old
``ppo/clip_fraction``                 share of the probability ratios that were clipped
``ppo/explained_variance``            of the returns by the critic; 1 is perfect
``ppo/gradient_norm``                 before it is scaled down
``ppo/learning_rate``                 of this update
``time/frames_per_second``            of the whole iteration, collection and updates
``time/collect_seconds``              of the iteration
``time/update_seconds``               of the iteration
``evaluation/goal_difference``        on fresh matches with the policy's sampled actions
``evaluation/goal_difference_low``    lower end of its 95 % interval
``evaluation/goal_difference_high``   upper end
====================================  ==============================================================

The x axis is environment frames throughout. ``metrics.csv`` in the run's directory has the same
numbers, a row per iteration, and ``evaluations.csv`` a row per evaluation.
"""

from __future__ import annotations

import csv
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDictBase
from torch.utils.tensorboard import SummaryWriter

from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX

if TYPE_CHECKING:
    from fbrl.evaluate import Evaluation

MATCHES_IN_MEAN = 100
"""Matches that the means over the latest matches take in; the environment's paper uses 100."""

_EPISODE_NAMES = {
    EPISODE_PREFIX + "reward_scoring": "match/goal_difference",
    EPISODE_LENGTH: "match/length",
    EPISODE_PREFIX + "reward": "reward/total",
}


class Monitor:
    """Writes the metrics of a run as TensorBoard events and as a CSV table.

    Args:
        run_dir: The run's directory; it must exist.
        reward_parts: Names of the reward's parts, as its transform gives them.

    Use it as a context manager, so that the files are closed.
    """

    def __init__(self, run_dir: Path, reward_parts: tuple[str, ...]) -> None:
        self._names = dict(_EPISODE_NAMES)
        self._part_names = {}
        for part in reward_parts:
            self._part_names[EPISODE_PREFIX + part] = part.replace("reward_", "reward/", 1)
        self._recent: dict[str, deque[float]] = {
            key: deque(maxlen=MATCHES_IN_MEAN) for key in {**self._names, **self._part_names}
        }
        self._matches = 0
        self._writer = SummaryWriter(str(run_dir))
        self._table = (run_dir / "metrics.csv").open("w", newline="", encoding="utf-8")
        self._csv: csv.DictWriter[str] | None = None
        self._evaluations = run_dir / "evaluations.csv"

    def __enter__(self) -> Monitor:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()
        self._table.close()

    def log_iteration(
        self,
        frames: int,
        batch: TensorDictBase,
        losses: Mapping[str, float],
        collect_seconds: float,
        update_seconds: float,
    ) -> dict[str, float]:
        """Writes the metrics of an iteration and returns them by name.

        Until the first match has ended there are none of ``match`` and ``reward``.

        Args:
            frames: Frames learned from so far, the x axis.
            batch: What was collected, shape (num_envs, num_steps).
            losses: What :meth:`fbrl.ppo.algorithm.PPO.learn` returned.
            collect_seconds: Time that collection took.
            update_seconds: Time that learning took.
        """
        self._add_matches(batch)
        metrics = {
            **self._match_metrics(),
            **{f"ppo/{name}": value for name, value in losses.items()},
            "time/frames_per_second": batch.numel() / (collect_seconds + update_seconds),
            "time/collect_seconds": collect_seconds,
            "time/update_seconds": update_seconds,
        }
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, frames)
        self._writer.flush()
        self._add_row({"frames": frames, **metrics})
        return metrics

    def log_evaluation(self, evaluation: Evaluation, frames: int) -> None:
        """Writes the goal difference on fresh matches with its interval."""
        low, high = evaluation.interval
        metrics = {
            "evaluation/goal_difference": evaluation.goal_difference,
            "evaluation/goal_difference_low": low,
            "evaluation/goal_difference_high": high,
        }
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, frames)
        self._writer.flush()
        matches = len(evaluation.goal_differences)
        row = {"frames": frames, **metrics, "evaluation/matches": matches}
        is_new = not self._evaluations.exists()
        with self._evaluations.open("a", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, list(row))
            if is_new:
                table.writeheader()
            table.writerow(row)

    def _add_matches(self, batch: TensorDictBase) -> None:
        following = batch.get("next")
        # In the order in which the matches ended: step by step, not match by match.
        ended = following.get("done").squeeze(-1).transpose(0, 1)
        self._matches += int(ended.sum())
        for key, values in self._recent.items():
            sums = following.get(key).squeeze(-1).transpose(0, 1)
            values.extend(sums[ended].to(torch.float64).tolist())

    def _match_metrics(self) -> dict[str, float]:
        if not self._matches:
            return {}
        means = {key: sum(values) / len(values) for key, values in self._recent.items()}
        return {
            **{name: means[key] for key, name in self._names.items()},
            **{name: means[key] for key, name in self._part_names.items()},
            "match/count": self._matches,
        }

    def _add_row(self, row: dict[str, float]) -> None:
        if self._csv is None:
            columns = ["frames", *self._names.values(), *self._part_names.values(), "match/count"]
            columns += [name for name in row if name not in columns]
            self._csv = csv.DictWriter(self._table, columns)
            self._csv.writeheader()
        self._csv.writerow(row)
        self._table.flush()
