"""Which matches the means take in, and what is written where."""

from __future__ import annotations

import csv
import io
import itertools
import re
import shutil
import subprocess
import sys
import time

import numpy as np
import PIL.Image
import pytest
import torch
from conftest import REPOSITORY
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout
from tensorboard.plugins.hparams.metadata import EXPERIMENT_TAG, SESSION_START_INFO_TAG
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData
from tensordict import TensorDict

from fbrl.config import TrainConfig
from fbrl.envs.actions import ACTION_NAMES
from fbrl.envs.engine import load_gfootball
from fbrl.evaluation.evaluation import Evaluation
from fbrl.files.appended_file import MOST_WAITING_BYTES, AppendedFile
from fbrl.monitor import BALL_POSITIONS, MATCHES_IN_MEAN, SCALARS, Monitor
from fbrl.monitor.scalars import GOAL_DIFFERENCE_NAMES
from fbrl.monitor.table import Table
from fbrl.monitor.writer import FRESH_FIGURES
from fbrl.transforms import PLAY_STATISTICS

PARTS = ("reward_scoring", "reward_start_density")


@pytest.fixture
def warned():
    return []


@pytest.fixture
def monitor(tmp_path, warned):
    return Monitor(tmp_path, TrainConfig("academy_corner"), PARTS, warned.append)


def make_batch(goals, done, length=10.0, actions=0, **play):
    """A batch whose entry (env, step) has these goals for, and ends where done."""
    goals = torch.tensor(goals, dtype=torch.float32).unsqueeze(-1)
    play = {"possession": 6.0, "opponent_possession": 2.0, "goals_for": goals.squeeze(-1), **play}
    statistics = torch.zeros(*goals.shape[:2], len(PLAY_STATISTICS))
    for name, value in play.items():
        statistics[..., PLAY_STATISTICS.index(name)] = torch.as_tensor(value)
    following = {
        "done": torch.tensor(done).unsqueeze(-1),
        "episode_reward": goals + 0.5,
        "episode_reward_scoring": goals - statistics[..., 1:2],
        "episode_reward_start_density": torch.full_like(goals, 0.5),
        "episode_reward_end_density": torch.zeros_like(goals),
        "step_count": torch.full(goals.shape, length),
        "play_statistics": statistics,
    }
    action = torch.as_tensor(actions).expand(goals.shape[:2])
    return TensorDict({"next": following, "action": action}, batch_size=goals.shape[:2])


def log(monitor, batch, frames=1):
    return monitor.log_iteration(frames, batch, {"entropy": 2.0}, 1.0, 3.0, 1.5)


def log_evaluation(monitor, frames, images=None):
    figures = {figure: np.full(4, 2.0) for figure in FRESH_FIGURES}
    figures["possession_share"] = np.array([0.5, np.nan, 0.25, 0.75])
    evaluation = Evaluation({"goal_difference": np.array([1.0, 0.0, 1.0, 1.0]), **figures})
    monitor.log_evaluation(evaluation, frames, seconds=2.0, images=images or {})
    return evaluation


def read_events(run_dir):
    events = EventAccumulator(str(run_dir))
    events.Reload()
    return events


def read_rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_means_over_ended_matches(monitor):
    done = [[False, True, False], [False, False, True]]
    metrics = log(monitor, make_batch([[7, 1, 7], [7, 7, 3]], done, length=12))
    assert metrics["match/count"] == 2
    assert metrics["match/goal_difference"] == 2.0
    assert metrics["match/length"] == 12.0
    assert metrics["reward/scoring"] == 2.0
    assert metrics["reward/start_density"] == 0.5
    assert metrics["reward/total"] == 2.5
    assert metrics["ppo/entropy"] == 2.0
    assert metrics["time/frames_per_second"] == pytest.approx(6 / 4)


def test_what_was_played_in_the_ended_matches(monitor):
    # Won 2-0, drawn 1-1, lost 0-1, lost 0-1; the second step of the last is of a running match.
    goals = [[9, 2], [9, 1], [9, 0], [0, 9]]
    done = [[False, True], [False, True], [False, True], [True, False]]
    play = {
        "goals_against": [[9, 0], [9, 1], [9, 1], [1, 9]],
        "possession": [[9, 30], [9, 10], [9, 0], [0, 9]],
        "opponent_possession": [[9, 10], [9, 10], [9, 5], [0, 9]],
        "passes": [[9, 4], [9, 0], [9, 1], [1, 9]],
        "shots": [[9, 3], [9, 1], [9, 0], [0, 9]],
    }
    metrics = log(monitor, make_batch(goals, done, **{k: torch.tensor(v) for k, v in play.items()}))
    assert (metrics["match/goals_for"], metrics["match/goals_against"]) == (0.75, 0.75)
    shares = [metrics[f"match/{result}_share"] for result in ("win", "draw", "loss")]
    assert shares == [0.25, 0.25, 0.5]
    # In the fourth nobody had the ball, so that there is nothing to share.
    assert metrics["play/possession_share"] == pytest.approx((0.75 + 0.5 + 0) / 3)
    assert (metrics["play/passes"], metrics["play/shots"]) == (1.5, 1.0)


def test_a_share_of_possession_that_no_match_has_is_left_out(monitor, tmp_path):
    batch = make_batch([[0]], [[True]], possession=0.0, opponent_possession=0.0)
    assert "play/possession_share" not in log(monitor, batch)
    assert read_rows(tmp_path / "metrics.csv")[0]["play/possession_share"] == ""


def test_shares_of_the_actions_are_those_of_the_iteration(monitor):
    actions = torch.tensor([[12, 12, 5, 0], [12, 18, 5, 5]])
    none = np.zeros((2, 4), bool)
    metrics = log(monitor, make_batch(np.zeros((2, 4)), none, actions=actions))
    shares = {name: value for name, value in metrics.items() if name.startswith("policy/action_")}
    assert len(shares) == 19
    assert {name: value for name, value in shares.items() if value} == {
        "policy/action_idle": 1 / 8,
        "policy/action_right": 3 / 8,
        "policy/action_shot": 3 / 8,
        "policy/action_release_dribble": 1 / 8,
    }
    metrics = log(monitor, make_batch(np.zeros((2, 4)), none, actions=9))
    assert metrics["policy/action_long_pass"] == 1


def test_the_actions_are_called_what_gfootball_calls_them():
    assert [a._name for a in load_gfootball().action_set.action_set_v1] == list(ACTION_NAMES)


def test_the_mean_is_over_the_latest_hundred_in_the_order_in_which_they_ended(monitor):
    assert MATCHES_IN_MEAN == 100
    # All matches end at every step; those of the later half of the steps are the latest 100.
    goals = np.zeros((4, 50))
    goals[:, 25:] = 1
    metrics = log(monitor, make_batch(goals, np.ones((4, 50), bool)))
    assert metrics["match/goal_difference"] == 1.0
    # 40 more push out the oldest 40.
    metrics = log(monitor, make_batch(np.full((4, 10), 6.0), np.ones((4, 10), bool)))
    assert metrics["match/goal_difference"] == pytest.approx((60 * 1 + 40 * 6) / 100)
    assert metrics["match/count"] == 240


def test_before_the_first_end_there_are_no_match_metrics(monitor, tmp_path):
    none = np.zeros((2, 3), bool)
    first = log(monitor, make_batch(np.ones((2, 3)), none), frames=6)
    log(monitor, make_batch(np.ones((2, 3)), ~none), frames=12)
    assert not [name for name in first if name.startswith(("match/", "reward/", "play/"))]
    rows = read_rows(tmp_path / "metrics.csv")
    assert [row["match/goal_difference"] for row in rows] == ["", "1.0"]
    events = read_events(tmp_path)
    assert [event.step for event in events.Scalars("match/goal_difference")] == [12]
    assert [event.step for event in events.Scalars("ppo/entropy")] == [6, 12]


def test_evaluations_are_kept_in_a_table_of_their_own(monitor, tmp_path):
    for frames in (0, 100):
        evaluation = log_evaluation(monitor, frames)
    rows = read_rows(tmp_path / "evaluations.csv")
    assert [int(row["frames"]) for row in rows] == [0, 100]
    low, high = evaluation.interval
    for row in rows:
        assert float(row["evaluation/goal_difference"]) == 0.75
        assert float(row["evaluation/goal_difference_low"]) == low
        assert float(row["evaluation/goal_difference_high"]) == high
        assert int(row["evaluation/matches"]) == 4
        assert float(row["evaluation/possession_share"]) == 0.5
        assert float(row["evaluation/shots"]) == 2.0
        assert float(row["evaluation/seconds"]) == 2.0


def test_the_hyperparameters_and_the_goal_difference_stand_in_the_run_itself(monitor, tmp_path):
    log_evaluation(monitor, 100)
    plugin = read_events(tmp_path).summary_metadata
    start, experiment = (
        HParamsPluginData.FromString(plugin[tag].plugin_data.content)
        for tag in (SESSION_START_INFO_TAG, EXPERIMENT_TAG)
    )
    values = start.session_start_info.hparams
    assert values["scenario"].string_value == "academy_corner"
    assert values["ppo.gamma"].number_value == 0.993
    assert values["ppo.anneal_learning_rate"].string_value == "True"
    assert values["network.hidden_sizes"].string_value == "256 256"
    assert "run_dir" not in values
    metrics = [info.name.tag for info in experiment.experiment.metric_infos]
    assert metrics == list(GOAL_DIFFERENCE_NAMES)
    assert [path.is_dir() for path in tmp_path.iterdir()] == [False, False]


def test_every_chart_of_the_layout_shows_documented_names(tmp_path):
    parts = ("reward_scoring", "reward_start_density", "reward_end_density")
    monitor = Monitor(tmp_path, TrainConfig("academy_corner"), parts, pytest.fail)
    log(monitor, make_batch([[1]], [[False]]))
    events = read_events(tmp_path)
    content = events.Tensors("custom_scalars__config__")[0].tensor_proto.string_val[0]
    layout = Layout.FromString(content)
    titles = [category.title for category in layout.category]
    assert titles == ["Goals", "Reward", "Play", "PPO", "Speed"]
    shown = set()
    for category in layout.category:
        for chart in category.chart:
            names = {n for n in SCALARS for tag in chart.multiline.tag if re.match(tag, n)}
            assert len(names) == len(chart.multiline.tag), chart.title
            for series in chart.margin.series:
                assert (series.value, series.lower, series.upper) == GOAL_DIFFERENCE_NAMES
                names.update(GOAL_DIFFERENCE_NAMES)
            assert names, chart.title
            shown |= names
    unseen = {name for name in set(SCALARS) - shown if not name.startswith("policy/")}
    assert unseen == {
        "match/count",
        "reward/checkpoint",
        "reward/potential",
        "evaluation/matches",
        "evaluation/seconds",
    }


@pytest.mark.parametrize("kind", ["PNG", "GIF"])
def test_pictures_are_kept_as_they_are(kind, monitor, tmp_path):
    file = io.BytesIO()
    PIL.Image.new("RGB", (30, 20), (255, 0, 0)).save(file, kind)
    log_evaluation(monitor, 100, {BALL_POSITIONS: file.getvalue()})
    (image,) = read_events(tmp_path).Images(BALL_POSITIONS)
    assert (image.step, image.width, image.height) == (100, 30, 20)
    assert image.encoded_image_string == file.getvalue()


FULL_DISK = """
import resource, sys
from pathlib import Path
import torch
from test_monitor import PARTS, log, log_evaluation, make_batch
from fbrl.config import TrainConfig
from fbrl.monitor import Monitor

monitor = Monitor(Path(sys.argv[1]), TrainConfig("academy_corner"), PARTS, print)
(events,) = Path(sys.argv[1]).iterdir()
resource.setrlimit(resource.RLIMIT_FSIZE, (events.stat().st_size + 5000, -1))
for frames in range(1, 101):
    metrics = log(monitor, make_batch([[1]], [[True]]), frames)
    log_evaluation(monitor, frames)
print("room again")
resource.setrlimit(resource.RLIMIT_FSIZE, (-1, -1))
log(monitor, make_batch([[1]], [[True]]), 101)
"""


def test_what_a_full_disk_keeps_out_of_the_log_is_written_later_with_a_warning_each(tmp_path):
    # A limit to the size of files, which the two larger ones reach.
    line = [sys.executable, "-c", FULL_DISK, tmp_path]
    done = subprocess.run(
        line, cwd=REPOSITORY / "tests", capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    files = ("TensorBoard's events", "metrics.csv")
    for file, line in zip(files, lines, strict=False):
        assert line.startswith(f"{file} can't be written ([Errno 27] File too large)")
    assert lines[2:] == ["room again", *(f"{file} can be written again." for file in files)]
    # Each value once, and in order.
    steps = [event.step for event in read_events(tmp_path).Scalars("ppo/entropy")]
    assert steps == list(range(1, 102))
    assert [int(row["frames"]) for row in read_rows(tmp_path / "metrics.csv")] == steps
    assert len(read_rows(tmp_path / "evaluations.csv")) == 100


def test_the_oldest_of_what_waits_is_lost_before_the_memory_is(tmp_path):
    file = AppendedFile(tmp_path / "missing" / "table", header=b"header ")
    for number in range(5):
        with pytest.raises(FileNotFoundError):
            file.append(bytes([number]) * (MOST_WAITING_BYTES // 4))
    (tmp_path / "missing").mkdir()
    file.append(b"last")
    content = file.path.read_bytes()
    assert content.startswith(b"header \x02")
    assert content.endswith(b"\x04last")


def test_a_run_directory_that_is_gone_for_a_while_leaves_the_rest_of_the_log(tmp_path, warned):
    run_dir = tmp_path / "run"
    run_dir.mkdir()
    monitor = Monitor(run_dir, TrainConfig("academy_corner"), PARTS, warned.append)
    log(monitor, make_batch([[1]], [[True]]), 1)
    shutil.rmtree(run_dir)
    for frames in (2, 3):
        assert log(monitor, make_batch([[1]], [[True]]), frames)["match/count"] == frames
        log_evaluation(monitor, frames)
    files = ["TensorBoard's events", "metrics.csv", "evaluations.csv"]
    assert [line.split(" can't")[0] for line in warned] == files
    run_dir.mkdir()
    log(monitor, make_batch([[1]], [[True]]), 4)
    assert [int(row["frames"]) for row in read_rows(run_dir / "metrics.csv")] == [2, 3, 4]
    events = read_events(run_dir)
    assert [event.step for event in events.Scalars("ppo/entropy")] == [2, 3, 4]
    assert [event.step for event in events.Scalars("evaluation/shots")] == [2, 3]


def test_a_clock_that_is_set_back_makes_no_time_negative(tmp_path, monkeypatch):
    times = itertools.count(2_000_000_000, -3600)
    monkeypatch.setattr(time, "time", lambda: float(next(times)))
    monitor = Monitor(tmp_path, TrainConfig("academy_corner"), PARTS, pytest.fail)
    for frames in (1, 2, 3):
        log(monitor, make_batch([[1]], [[True]]), frames)
    walls = [event.wall_time for event in read_events(tmp_path).Scalars("ppo/entropy")]
    assert walls == sorted(walls)
    assert len(walls) == 3


def test_a_table_of_before_keeps_its_columns(tmp_path):
    path = tmp_path / "metrics.csv"
    path.write_text("frames,b\n32,1.0\n")
    table = Table(path, ["frames", "a", "b"])
    table.append({"frames": 64, "a": 2.0, "b": 3.0})
    assert path.read_text().split() == ["frames,b", "32,1.0", "64,3.0"]
