"""Which matches the means take in, and what is written where."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensordict import TensorDict

from fbrl.evaluate import Evaluation
from fbrl.monitor import MATCHES_IN_MEAN, Monitor

PARTS = ("reward_scoring", "reward_start_density")


def make_batch(goals, done, length=10.0):
    """A batch whose entry (env, step) has these sums of goals, and ends where done."""
    goals = torch.tensor(goals, dtype=torch.float32).unsqueeze(-1)
    following = {
        "done": torch.tensor(done).unsqueeze(-1),
        "episode_reward": goals + 0.5,
        "episode_reward_scoring": goals,
        "episode_reward_start_density": torch.full_like(goals, 0.5),
        "step_count": torch.full(goals.shape, length),
    }
    return TensorDict({"next": following}, batch_size=goals.shape[:2])


def log(monitor, batch, frames=1):
    return monitor.log_iteration(frames, batch, {"entropy": 2.0}, 1.0, 3.0)


def test_means_over_ended_matches(tmp_path):
    done = [[False, True, False], [False, False, True]]
    with Monitor(tmp_path, PARTS) as monitor:
        metrics = log(monitor, make_batch([[7, 1, 7], [7, 7, 3]], done, length=12))
    assert metrics["match/count"] == 2
    assert metrics["match/goal_difference"] == 2.0
    assert metrics["match/length"] == 12.0
    assert metrics["reward/scoring"] == 2.0
    assert metrics["reward/start_density"] == 0.5
    assert metrics["reward/total"] == 2.5
    assert metrics["ppo/entropy"] == 2.0
    assert metrics["time/frames_per_second"] == pytest.approx(6 / 4)


def test_the_mean_is_over_the_latest_hundred_in_the_order_in_which_they_ended(tmp_path):
    assert MATCHES_IN_MEAN == 100
    # All matches end at every step; those of the later half of the steps are the latest 100.
    goals = np.zeros((4, 50))
    goals[:, 25:] = 1
    with Monitor(tmp_path, PARTS) as monitor:
        metrics = log(monitor, make_batch(goals, np.ones((4, 50), bool)))
        assert metrics["match/goal_difference"] == 1.0
        # 40 more push out the oldest 40.
        metrics = log(monitor, make_batch(np.full((4, 10), 6.0), np.ones((4, 10), bool)))
    assert metrics["match/goal_difference"] == pytest.approx((60 * 1 + 40 * 6) / 100)
    assert metrics["match/count"] == 240


def test_before_the_first_end_there_are_no_match_metrics(tmp_path):
    none = np.zeros((2, 3), bool)
    with Monitor(tmp_path, PARTS) as monitor:
        first = log(monitor, make_batch(np.ones((2, 3)), none), frames=6)
        log(monitor, make_batch(np.ones((2, 3)), ~none), frames=12)
    assert not [name for name in first if name.startswith(("match/", "reward/"))]
    with (tmp_path / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["match/goal_difference"] for row in rows] == ["", "1.0"]
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert [event.step for event in events.Scalars("match/goal_difference")] == [12]
    assert [event.step for event in events.Scalars("ppo/entropy")] == [6, 12]


def test_evaluations_are_kept_in_a_table_of_their_own(tmp_path):
    evaluation = Evaluation(np.array([1.0, 0.0, 1.0, 1.0]), np.ones(4))
    with Monitor(tmp_path, PARTS) as monitor:
        monitor.log_evaluation(evaluation, frames=0)
        monitor.log_evaluation(evaluation, frames=100)
    with (tmp_path / "evaluations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frames"]) for row in rows] == [0, 100]
    low, high = evaluation.interval
    for row in rows:
        assert float(row["evaluation/goal_difference"]) == 0.75
        assert float(row["evaluation/goal_difference_low"]) == low
        assert float(row["evaluation/goal_difference_high"]) == high
        assert int(row["evaluation/matches"]) == 4
