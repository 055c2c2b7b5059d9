"""Presets, checks and the file of a run's configuration."""

from __future__ import annotations

import dataclasses
import json
from inspect import signature
from typing import get_args

import pytest

from fbrl.config import (
    ACTIVATION_NAMES,
    NETWORK_NAMES,
    OBSERVATION_NAMES,
    REWARD_NAMES,
    ConfigError,
    PPOConfig,
    TrainConfig,
)
from fbrl.config_json import config_from_dict, save_config
from fbrl.envs import factory
from fbrl.models import MLP, actor_critic, build_actor_critic, mlp
from fbrl.presets import preset_config

# Table 5.1 of the thesis: academy scenarios, 11 against 11.
TABLE_5_1 = {
    "learning_rate": (3.43e-4, 3.43e-4),
    "num_steps": (512, 1024),
    "num_minibatches": (8, 64),
    "num_epochs": (2, 4),
    "gamma": (0.993, 0.993),
    "gae_lambda": (0.95, 0.95),
    "clip_epsilon": (0.08, 0.08),
    "entropy_coeff": (0.00155, 0.00155),
    "critic_coeff": (0.5, 0.5),
    "max_grad_norm": (0.64, 0.64),
    "total_frames": (1_000_000, 5_000_000),
}


@pytest.mark.parametrize(
    ("scenario", "column"),
    [
        ("academy_counterattack_hard", 0),
        ("academy_3_vs_1_with_keeper", 0),
        ("11_vs_11_easy_stochastic", 1),
    ],
)
def test_the_thesis_preset_is_table_5_1(scenario, column):
    config = preset_config("thesis", scenario)
    for name, values in TABLE_5_1.items():
        assert getattr(config.ppo, name) == values[column], name
    assert config.ppo.anneal_learning_rate
    assert config.observation == "minimap"
    assert config.reward == "analytics"
    config.check()


def test_the_light_preset_is_for_a_cpu():
    config = preset_config("light", "academy_empty_goal")
    assert config.observation == "simple115"
    config.check()


def test_names_agree_with_those_of_the_factory_and_the_networks():
    assert set(REWARD_NAMES) == set(factory.REWARDS)
    assert set(OBSERVATION_NAMES) == set(factory.OBSERVATIONS)
    assert set(OBSERVATION_NAMES) == set(actor_critic.OBSERVATION_KEYS)
    assert set(OBSERVATION_NAMES) == set(get_args(actor_critic.ObservationName))
    assert set(ACTIVATION_NAMES) == set(get_args(mlp.Activation))
    assert set(NETWORK_NAMES) == set(get_args(actor_critic.NetworkName))


def test_a_network_is_by_default_that_of_a_training():
    given = {
        name: value.default for name, value in signature(build_actor_critic).parameters.items()
    }
    trained = TrainConfig("academy_empty_goal")
    assert given["activation"] == trained.activation
    assert given["hidden_sizes"] == trained.hidden_sizes
    assert given["network"] == trained.network
    assert given["is_mirrored"] == trained.mirror
    assert signature(MLP).parameters["activation"].default == trained.activation


def test_batch_sizes():
    config = PPOConfig(num_envs=6, num_steps=50, num_minibatches=4, total_frames=1000)
    assert config.frames_per_batch == 300
    assert config.num_batches == 4
    assert config.frames_per_minibatch == 75
    assert dataclasses.replace(config, minibatch_size=32).frames_per_minibatch == 32


def test_a_configuration_survives_its_file(tmp_path):
    config = dataclasses.replace(
        preset_config("thesis", "11_vs_11_easy_stochastic"),
        run_dir=tmp_path,
        hidden_sizes=(64, 32),
        density="my.npz",
    )
    save_config(config, tmp_path / "config.json")
    assert config_from_dict(json.loads((tmp_path / "config.json").read_text())) == config


@pytest.mark.parametrize(
    "values",
    [{}, {"scenario": "a", "colour": "red"}, {"scenario": "a", "ppo": {"gama": 1}}],
)
def test_a_dictionary_that_is_no_configuration_is_refused(values):
    with pytest.raises(ConfigError, match="no configuration of a training"):
        config_from_dict(values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0; it must be at least 1"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"clip_epsilon": -0.1}, "clip_epsilon is -0.1"),
        ({"critic_coeff": 0.0}, "critic_coeff is 0.0"),
        ({"entropy_coeff": float("inf")}, "entropy_coeff is inf"),
        ({"gamma": 1.01}, r"gamma is 1.01; it must be in \[0, 1\]"),
        ({"minibatch_size": 1}, "minibatch_size is 1"),
        ({"minibatch_size": 5000}, r"in \[2, 4096\]"),
        ({"num_minibatches": 4096}, "at most 2048"),
    ],
)
def test_impossible_hyperparameters_are_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        PPOConfig(**changes).check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hidden_sizes": ()}, "hidden_sizes is ()"),
        ({"hidden_sizes": (64, 0)}, "positive widths"),
        ({"seed": -1}, "seed is -1"),
        ({"num_threads": 0}, "num_threads is 0"),
        ({"eval_episodes": -1}, "eval_episodes is -1"),
        ({"checkpoint_interval": 0}, "checkpoint_interval is 0"),
        ({"activation": "swish"}, "no activation 'swish'"),
        ({"mask": "engines"}, "Did you mean engine"),
        ({"network": "player_sets"}, "Did you mean player_set"),
        ({"network": "player_set"}, "the observation is simple115. Add --observation players"),
        ({"transition": "possesion"}, "Did you mean possession"),
        ({"episode_cap": -0.5}, "episode_cap is -0.5"),
        ({"episode_cap": float("inf")}, "episode_cap is inf"),
        (
            {"reward": "potential", "episode_cap": 0.5},
            "episode_cap (0.5) is only used by the analytics reward, and the reward is potential",
        ),
        (
            {"reward": "scoring", "density": "uniform"},
            "density (uniform) is only used by the analytics or the potential reward",
        ),
    ],
)
def test_impossible_settings_are_named(changes, message):
    config = TrainConfig("academy_empty_goal", **changes)
    with pytest.raises(ValueError, match=message.replace("(", r"\(").replace(")", r"\)")):
        config.check()


def test_every_field_is_documented():
    import inspect

    for config in (PPOConfig, TrainConfig):
        source = inspect.getsource(config)
        for field in dataclasses.fields(config):
            after = source.split(f"    {field.name}: ", 1)[1].split("\n", 2)[1]
            assert after.strip().startswith('"""'), f"{config.__name__}.{field.name}"
