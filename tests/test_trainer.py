"""The run as the trainer orders it: what reaches what, and when it is saved."""

from __future__ import annotations

import dataclasses
import io
import signal
import sys
import time

import numpy as np
import PIL.Image
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fbrl import assembly
from fbrl.analysis.run_log import read_run_log
from fbrl.assembly import make_model, make_training_reward
from fbrl.checkpoint import CheckpointError, load_checkpoint
from fbrl.cli.train_options import parse_training
from fbrl.collect import MatchCollector
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs.matches import Matches
from fbrl.monitor import BALL_POSITIONS, MATCH_VIDEO
from fbrl.ppo.update import TrainingDivergedError
from fbrl.run_files import CHECKPOINT_NAME
from fbrl.training import TrainListener, run_checkpoints, train, trainer
from fbrl.training.evaluator import MatchPictures
from fbrl.training.trainer import evaluation_is_due
from fbrl.transforms import MiniMapCells

SPEED = (
    "time/frames_per_second",
    "time/collect_seconds",
    "time/update_seconds",
    "time/collect_cores",
)
SMALL = PPOConfig(total_frames=256, num_envs=2, num_steps=32, num_minibatches=2, num_epochs=1)


@pytest.fixture
def config(tmp_path):
    return TrainConfig(
        "academy_empty_goal_close", run_dir=tmp_path / "run", eval_episodes=4, ppo=SMALL
    )


def test_the_command_line_fills_in_the_row_of_the_table_that_the_scenario_has():
    academy = parse_training("fbrl-train", ["academy_counterattack_hard", "--preset", "thesis"])
    assert (academy.ppo.num_steps, academy.ppo.num_minibatches) == (512, 8)
    assert (academy.ppo.total_frames, academy.eval_episodes) == (1_000_000, 200)
    full = parse_training(
        "fbrl-train", ["--preset=thesis", "11_vs_11_easy_stochastic", "--num-epochs", "3"]
    )
    assert (full.ppo.num_steps, full.ppo.num_minibatches) == (1024, 64)
    assert (full.ppo.total_frames, full.ppo.num_epochs) == (5_000_000, 3)
    assert full.observation == "minimap"
    assert (full.eval_episodes, full.eval_interval) == (16, 500_000)
    assert (academy.eval_interval, academy.interim_eval_episodes) == (100_000, 50)


def test_options_reach_the_configuration():
    line = (
        "academy_corner --gamma 0.9 --network.hidden-sizes 32 16 --reward scoring --num-threads 1 "
        "--no-anneal-learning-rate --minibatch-size 100"
    )
    config = parse_training("fbrl-train", line.split())
    assert config.ppo.gamma == 0.9
    assert config.network_options == {"hidden_sizes": (32, 16)}
    assert (config.reward, config.num_threads) == ("scoring", 1)
    assert not config.ppo.anneal_learning_rate
    assert config.ppo.steps_per_minibatch == 100


def test_the_network_is_the_one_that_was_asked_for(config):
    config = dataclasses.replace(
        config, network_options={"hidden_sizes": (32, 16), "activation": "tanh"}
    )
    trunk = make_model(config, torch.device("cpu")).get_collection_policy().trunk
    assert [m.out_features for m in trunk if isinstance(m, torch.nn.Linear)] == [32, 16]
    assert any(isinstance(module, torch.nn.Tanh) for module in trunk)


def test_settings_reach_the_environment_and_the_reward(config, monkeypatch):
    made = {}

    class RecordingCollector(MatchCollector):
        def __init__(self, scenario, policy, **options):
            made.update(options, scenario=scenario)
            super().__init__(scenario, policy, **options)

    monkeypatch.setattr(assembly, "MatchCollector", RecordingCollector)
    config = dataclasses.replace(
        config,
        reward_options={"transition": "consecutive"},
        num_threads=1,
        observation="minimap",
        eval_episodes=0,
    )
    train(config)
    assert made["scenario"] == "academy_empty_goal_close"
    assert made["reward"].transition == "consecutive"
    assert (made["num_threads"], made["num_envs"]) == (1, 2)
    assert isinstance(made["observation"], MiniMapCells)


def test_the_options_of_a_reward_come_from_the_configuration(config):
    ppo = dataclasses.replace(config.ppo, gamma=0.875)
    potential = dataclasses.replace(
        config, reward="potential", reward_options={"density": "uniform"}, ppo=ppo
    )
    transform = make_training_reward(potential)
    assert transform.gamma == 0.875, "the discount that the agent is trained with"
    assert transform.density.end.grid.min() == 1, "the uniform density"
    capped = make_training_reward(dataclasses.replace(config, reward_options={"episode_cap": 0.25}))
    assert (capped.episode_cap, capped.transition) == (0.25, "possession")


def test_the_evaluation_plays_other_matches_than_the_training(config, monkeypatch):
    played: dict[int, list[int]] = {}
    original = Matches.prepare

    def prepare(self, match, seed, episode_number):
        original(self, match, seed, episode_number)
        played.setdefault(id(self), []).append(seed)

    monkeypatch.setattr(Matches, "prepare", prepare)
    train(dataclasses.replace(config, eval_untrained=True, eval_pictures=False))
    training, evaluation = played.values()
    assert min(len(training), len(evaluation)) >= 4
    assert set(training).isdisjoint(evaluation)
    # Before and after on the same fresh matches: the difference is the policy's.
    assert len(set(evaluation)) <= len(evaluation) - 4


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A run with two evaluations in between, 100 frames apart, and what its listener was told."""
    config = dataclasses.replace(
        TrainConfig("academy_empty_goal_close", eval_episodes=8, eval_interval=100, ppo=SMALL),
        run_dir=tmp_path_factory.mktemp("evaluated") / "run",
        ppo=dataclasses.replace(SMALL, total_frames=320),
    )
    told = {"metrics": [], "evaluations": set()}
    listener = TrainListener(
        on_metrics=lambda frames, metrics: told["metrics"].append(metrics),
        on_evaluation=lambda which, done, wanted: told["evaluations"].add((which, wanted)),
    )
    started = time.perf_counter()
    train(config, listener)
    return config, told, time.perf_counter() - started


@pytest.mark.parametrize(
    ("interval", "expected"), [(100, [128, 256]), (64, [64, 128, 192, 256]), (1000, []), (0, [])]
)
def test_evaluations_are_due_at_the_batch_that_reaches_the_interval(interval, expected, config):
    ppo = dataclasses.replace(SMALL, total_frames=320)
    config = dataclasses.replace(config, eval_interval=interval, ppo=ppo)
    # Batches of 64 frames; after the last one comes the evaluation of the trained policy.
    due = [f for f in range(64, 321, 64) if evaluation_is_due(config, f, f - 64)]
    assert due == expected


def test_evaluations_come_in_between_and_at_the_end(evaluated):
    config, told, _ = evaluated
    table = read_run_log(config.run_dir).evaluations
    assert table["frames"].tolist() == [128, 256, 320]
    assert table["evaluation/matches"].tolist() == [4, 4, 8]
    assert told["evaluations"] == {("current", 2), ("trained", 8)}


def test_evaluations_change_nothing_in_the_training(evaluated, config):
    other, *_ = evaluated
    train(dataclasses.replace(config, ppo=other.ppo, eval_episodes=0))
    one, two = (read_run_log(run.run_dir).metrics for run in (config, other))
    for name in set(one) - set(SPEED):
        np.testing.assert_array_equal(one[name], two[name], name)
    weights, others = (load_checkpoint(run.run_dir)["model"] for run in (config, other))
    for name, value in weights.items():
        assert torch.equal(value, others[name]), name


def test_the_time_of_evaluations_is_not_in_the_speed(evaluated):
    config, told, whole = evaluated
    evaluating = read_run_log(config.run_dir).evaluations["evaluation/seconds"].sum()
    training = sum(64 / metrics["time/frames_per_second"] for metrics in told["metrics"])
    assert len(told["metrics"]) == 5
    assert training + evaluating < whole


def read_images(run_dir):
    events = EventAccumulator(str(run_dir))
    events.Reload()
    return events.Tags()["images"]


def test_each_evaluation_draws_where_the_agent_has_the_ball(evaluated):
    config, *_ = evaluated
    events = EventAccumulator(str(config.run_dir))
    events.Reload()
    pictures = events.Images(BALL_POSITIONS)
    assert [picture.step for picture in pictures] == [128, 256, 320]
    image = np.asarray(PIL.Image.open(io.BytesIO(pictures[-1].encoded_image_string)).convert("RGB"))
    assert image.shape == (pictures[-1].height, pictures[-1].width, 3)
    # Three pitches in dark blue to yellow, on white.
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 1000


def test_each_evaluation_films_a_match(evaluated):
    config, *_ = evaluated
    events = EventAccumulator(str(config.run_dir))
    events.Reload()
    films = events.Images(MATCH_VIDEO)
    assert [film.step for film in films] == [128, 256, 320]
    with PIL.Image.open(io.BytesIO(films[-1].encoded_image_string)) as film:
        assert (film.format, film.width, film.info["duration"]) == ("GIF", 480, 100)
        assert 3 <= film.n_frames <= 200
        first = np.asarray(film.convert("RGB"))
        film.seek(film.n_frames - 1)
        assert (np.asarray(film.convert("RGB")) != first).any()


def test_without_evaluations_there_are_none_in_between_either(config):
    result = train(dataclasses.replace(config, eval_episodes=0, eval_interval=64))
    assert result.trained is None
    assert read_run_log(config.run_dir).evaluations == {}


def test_without_the_extra_pictures_are_left_out_with_one_warning(config, monkeypatch):
    monkeypatch.setitem(sys.modules, "mplsoccer", None)  # as if it were not installed
    warned = []
    result = train(config, TrainListener(on_warning=warned.append))
    assert result.trained is not None
    assert len(warned) == 1
    assert "mplsoccer" in warned[0]
    assert "pip install" in warned[0]
    assert "eval_pictures=False, --no-eval-pictures" in warned[0]
    assert read_images(config.run_dir) == []


def test_pictures_that_fail_end_no_training(config, monkeypatch):
    def fail(self, positions):
        raise ValueError("backend 'module://somebody_elses' is no valid value")

    monkeypatch.setattr(MatchPictures, "positions", fail)
    warned = []
    result = train(config, TrainListener(on_warning=warned.append))
    assert result.trained is not None
    assert len(warned) == 1
    assert "go on without pictures (ValueError: backend 'module://" in warned[0]
    assert read_images(config.run_dir) == []


def test_pictures_can_be_turned_off(config):
    train(dataclasses.replace(config, eval_pictures=False))
    assert read_images(config.run_dir) == []


def test_checkpoints_are_saved_at_each_interval_with_all_that_training_needs(config, monkeypatch):
    saved = []
    monkeypatch.setattr(
        run_checkpoints, "save_checkpoint", lambda path, **content: saved.append(content)
    )
    train(dataclasses.replace(config, checkpoint_interval=100, eval_episodes=0))
    assert [content["frames"] for content in saved] == [0, 128, 256, 256]
    assert not saved.pop(0)["optimizer"]["state"]
    for content in saved:
        assert content["config"]["scenario"] == config.scenario
        assert len(content["optimizer"]["state"]) == len(content["model"])
    first, last = saved[0]["optimizer"]["state"][0], saved[-1]["optimizer"]["state"][0]
    assert last["step"] > 0
    assert first.keys() >= {"exp_avg", "exp_avg_sq"}


def test_a_diverging_training_stops_and_keeps_the_last_checkpoint(config):
    ppo = dataclasses.replace(SMALL, learning_rate=1e30, total_frames=640)
    config = dataclasses.replace(config, ppo=ppo, eval_episodes=0)
    with pytest.raises(TrainingDivergedError, match="lower learning_rate"):
        train(config)
    assert load_checkpoint(config.run_dir)["frames"] == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_an_update_is_answered_and_the_update_finished(number, config, monkeypatch):
    answered = []
    original = trainer.PPO.learn

    def learn(self, batch):
        losses = original(self, batch)
        if self.frames == 128:
            signal.raise_signal(number)
        return losses

    monkeypatch.setattr(trainer.PPO, "learn", learn)
    listener = TrainListener(on_postponed=lambda: answered.append(True))
    result = train(config, listener)
    assert answered == [True]
    assert (result.interrupted, result.frames, result.trained) == (True, 128, None)
    assert (config.run_dir / CHECKPOINT_NAME).exists()


def test_a_signal_during_the_evaluation_ends_it_after_the_checkpoint(config):
    def on_evaluation(which, done, wanted):
        signal.raise_signal(signal.SIGINT)

    result = train(config, TrainListener(on_evaluation=on_evaluation))
    assert (result.interrupted, result.frames, result.trained) == (True, 256, None)
    assert (config.run_dir / CHECKPOINT_NAME).exists()


def test_a_bad_density_is_answered_before_anything_is_made(config, tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"no density")
    with pytest.raises(ConfigError, match=r"bad\.npz"):
        train(dataclasses.replace(config, reward_options={"density": str(tmp_path / "bad.npz")}))
    assert not config.run_dir.exists()


def test_a_training_may_begin_with_the_weights_of_another(config, tmp_path):
    first = train(dataclasses.replace(config, run_dir=tmp_path / "first"))
    learned = load_checkpoint(first.run_dir)["model"]
    beginnings = []
    harder = dataclasses.replace(
        config,
        scenario="academy_pass_and_shoot_with_keeper",
        initial_weights=str(first.run_dir),
        run_dir=tmp_path / "second",
        # Next to nothing is learned.
        ppo=dataclasses.replace(config.ppo, learning_rate=1e-12),
    )
    second = train(
        harder, TrainListener(on_start=lambda run_dir, device, frames: beginnings.append(frames))
    )
    assert beginnings == [0]
    for name, weight in load_checkpoint(second.run_dir)["model"].items():
        torch.testing.assert_close(weight, learned[name], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation": "players"}, "whose observation is simple115; here it is players"),
        ({"mirror": True}, "whose mirror is False; here it is True"),
        ({"network_options": {"hidden_sizes": (5,)}}, "whose network_options is"),
    ],
)
def test_weights_of_another_network_are_refused(config, tmp_path, changes, message):
    first = train(dataclasses.replace(config, run_dir=tmp_path / "first", eval_episodes=0))
    other = dataclasses.replace(
        config, initial_weights=str(first.run_dir), run_dir=tmp_path / "second", **changes
    )
    with pytest.raises(ConfigError, match=message):
        train(other)
    assert not (tmp_path / "second").exists()


def test_a_missing_training_to_begin_with_is_named(config, tmp_path):
    with pytest.raises(CheckpointError, match="nowhere"):
        train(dataclasses.replace(config, initial_weights=str(tmp_path / "nowhere")))
