"""The run as the trainer orders it: what reaches what, and when it is saved."""

from __future__ import annotations

import dataclasses
import signal

import pytest
import torch

from fbrl.agent import make_model
from fbrl.cli.train import parse
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs.football import FootballVectorEnv
from fbrl.ppo import trainer
from fbrl.ppo.trainer import TrainListener, choose_device, train
from fbrl.ppo.update import TrainingDivergedError

SMALL = PPOConfig(total_frames=256, num_envs=2, num_steps=32, num_minibatches=2, num_epochs=1)


@pytest.fixture
def config(tmp_path):
    return TrainConfig(
        "academy_empty_goal_close", run_dir=tmp_path / "run", eval_episodes=4, ppo=SMALL
    )


def test_the_command_line_fills_in_the_row_of_the_table_that_the_scenario_has():
    academy = parse(["academy_counterattack_hard", "--preset", "thesis"])
    assert (academy.ppo.num_steps, academy.ppo.num_minibatches) == (512, 8)
    assert (academy.ppo.total_frames, academy.eval_episodes) == (1_000_000, 200)
    full = parse(["--preset=thesis", "11_vs_11_easy_stochastic", "--num-epochs", "3"])
    assert (full.ppo.num_steps, full.ppo.num_minibatches) == (1024, 64)
    assert (full.ppo.total_frames, full.ppo.num_epochs) == (5_000_000, 3)
    assert full.observation == "minimap"
    assert full.eval_episodes == 16


def test_options_reach_the_configuration():
    line = (
        "academy_corner --gamma 0.9 --hidden-sizes 32 16 --reward scoring --num-threads 1 "
        "--no-anneal-learning-rate --minibatch-size 100"
    )
    config = parse(line.split())
    assert config.ppo.gamma == 0.9
    assert config.hidden_sizes == (32, 16)
    assert (config.reward, config.num_threads) == ("scoring", 1)
    assert not config.ppo.anneal_learning_rate
    assert config.ppo.frames_per_minibatch == 100


def test_the_network_is_the_one_that_was_asked_for(config):
    config = dataclasses.replace(config, hidden_sizes=(32, 16), activation="tanh")
    trunk = make_model(config, torch.device("cpu")).get_collection_policy().trunk
    assert [m.out_features for m in trunk if isinstance(m, torch.nn.Linear)] == [32, 16]
    assert any(isinstance(module, torch.nn.Tanh) for module in trunk)


def test_settings_reach_the_environment_and_the_reward(config, monkeypatch):
    made = {}

    def make_env(scenario, **options):
        made.update(options, scenario=scenario)
        return original(scenario, **options)

    original = trainer.make_env
    monkeypatch.setattr(trainer, "make_env", make_env)
    config = dataclasses.replace(
        config, transition="consecutive", num_threads=1, observation="minimap", eval_episodes=0
    )
    train(config)
    assert made["scenario"] == "academy_empty_goal_close"
    assert made["reward"].transition == "consecutive"
    assert (made["num_threads"], made["num_envs"]) == (1, 2)
    assert made["observation"] == "minimap"


def test_the_evaluation_plays_other_matches_than_the_training(config, monkeypatch):
    played: dict[str, set[int]] = {"untrained": set(), "training": set(), "trained": set()}
    phase = ["untrained"]
    original = FootballVectorEnv._next_episode

    def next_episode(self, index, seed):
        engine_seed = original(self, index, seed)
        played[phase[0]].add(engine_seed)
        return engine_seed

    monkeypatch.setattr(FootballVectorEnv, "_next_episode", next_episode)

    def on_metrics(frames, metrics):
        phase[0] = "trained" if frames >= 256 else "training"

    def on_evaluation(which, done, wanted):
        phase[0] = "training" if which == "untrained" and done >= wanted else phase[0]

    train(
        dataclasses.replace(config, eval_untrained=True),
        TrainListener(on_metrics=on_metrics, on_evaluation=on_evaluation),
    )
    assert len(played["training"]) >= 4
    assert len(played["trained"]) >= 4
    assert played["training"].isdisjoint(played["trained"])
    # Before and after on the same fresh matches: the difference is the policy's.
    assert played["untrained"] & played["trained"]


def test_checkpoints_are_saved_at_each_interval_with_all_that_training_needs(config, monkeypatch):
    saved = []
    monkeypatch.setattr(trainer, "save_checkpoint", lambda path, **content: saved.append(content))
    train(dataclasses.replace(config, checkpoint_interval=100, eval_episodes=0))
    assert [content["frames"] for content in saved] == [128, 256, 256]
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
    checkpoint = config.run_dir / "checkpoints" / "last.pt"
    assert not checkpoint.exists()


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
    assert (config.run_dir / trainer.CHECKPOINT_NAME).exists()


def test_a_signal_during_the_evaluation_ends_it_after_the_checkpoint(config):
    def on_evaluation(which, done, wanted):
        signal.raise_signal(signal.SIGINT)

    result = train(config, TrainListener(on_evaluation=on_evaluation))
    assert (result.interrupted, result.frames, result.trained) == (True, 256, None)
    assert (config.run_dir / trainer.CHECKPOINT_NAME).exists()


@pytest.mark.parametrize("name", ["tpu", "cuda:99", "meta"])
def test_a_device_that_is_not_there_is_named(name):
    with pytest.raises(ConfigError, match=f"device is '{name}'"):
        choose_device(name)


def test_a_bad_density_is_answered_before_anything_is_made(config, tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"no density")
    with pytest.raises(ConfigError, match=r"bad\.npz"):
        train(dataclasses.replace(config, density=str(tmp_path / "bad.npz")))
    assert not config.run_dir.exists()
