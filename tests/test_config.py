"""Presets, checks and the file of a run's configuration."""

from __future__ import annotations

import dataclasses
import json
from inspect import signature

import pytest

from fbrl.agent import load_agent
from fbrl.components import COMPONENTS, LOGGERS
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.config_json import config_from_dict, config_to_dict, save_config
from fbrl.presets import PRESETS, nearest_preset, preset_config

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


def test_the_strong_preset_goes_on_from_the_agents_that_come_along():
    config = preset_config("strong", "academy_counterattack_easy")
    agent = load_agent("pretrained:academy_3_vs_1_with_keeper").config
    read = ("observation", "observation_options", "network_name", "network_options", "mirror")
    for name in read:
        assert getattr(config, name) == getattr(agent, name)
    config.check()
    learned = load_agent("pretrained:academy_counterattack_easy").config
    frames = learned.ppo.total_frames
    assert dataclasses.replace(config.ppo, total_frames=frames) == learned.ppo
    assert (learned.reward, learned.observation) == (config.reward, config.observation)


def test_a_configuration_without_more_is_the_light_preset():
    assert TrainConfig("academy_empty_goal") == preset_config("light", "academy_empty_goal")


@pytest.mark.parametrize("preset", PRESETS)
def test_the_nearest_preset_is_the_one_that_was_begun_with(preset):
    config = preset_config(preset, "academy_empty_goal")
    assert nearest_preset(dataclasses.replace(config, reward="scoring", seed=5)) == preset


@pytest.mark.parametrize(
    ("registry", "name"),
    [(registry, name) for registry in COMPONENTS.values() for name in registry.built_in],
)
def test_options_are_arguments_of_what_they_describe(registry, name):
    """With the same defaults: they are written twice, so that --help imports no PyTorch."""
    arguments = signature(registry.load(name)).parameters
    for option in dataclasses.fields(registry.options(name)):
        assert arguments[option.name].default == option.default, option.name


def test_every_name_can_be_imported():
    for registry in (*COMPONENTS.values(), LOGGERS):
        for name in registry.built_in:
            assert callable(registry.load(name))


def test_batch_sizes():
    config = PPOConfig(num_envs=6, num_steps=50, num_minibatches=4, total_frames=1000)
    assert config.frames_per_batch == 300
    assert config.num_batches == 4
    assert config.steps_per_minibatch == 75
    assert dataclasses.replace(config, minibatch_size=32).steps_per_minibatch == 32


def test_a_configuration_survives_its_file(tmp_path):
    config = dataclasses.replace(
        preset_config("thesis", "11_vs_11_easy_stochastic"),
        run_dir=tmp_path,
        network="mlp",
        network_options={"hidden_sizes": (64, 32)},
        reward_options={"density": "my.npz"},
    )
    save_config(config, tmp_path / "config.json")
    values = json.loads((tmp_path / "config.json").read_text())
    assert config_from_dict(values) == config
    assert values["reward_options"] == {
        "density": "my.npz",
        "weight": 1.0,
        "transition": "possession",
        "start_weight": 1.0,
        "end_weight": 1.0,
        "episode_cap": None,
        "release_at_goal": False,
    }, "what is not given stands in the file, too"


@pytest.mark.parametrize(
    ("observation", "former", "now"),
    [
        ("simple115", {"hidden_sizes": [8], "activation": "tanh"},
         {"network": "mlp", "network_options": {"hidden_sizes": (8,), "activation": "tanh"}}),
        ("minimap", {"hidden_sizes": [8]}, {"network": None}),
        ("simple115", {"density": "my.npz", "transition": "consecutive", "episode_cap": 0.5},
         {"network": "mlp", "reward_options": {
             "density": "my.npz", "transition": "consecutive", "episode_cap": 0.5}}),
        ("simple115", {"density": None, "transition": "possession", "episode_cap": None},
         {"network": "mlp"}),
    ],
)  # fmt: skip
def test_a_configuration_of_before_is_read(observation, former, now):
    values = config_to_dict(TrainConfig("academy_empty_goal", observation=observation))
    del values["reward_options"], values["network_options"]
    defaults = {"hidden_sizes": [256, 256], "activation": "relu", "network": "mlp"}
    values |= {"preset": "light", **defaults, **former}
    expected = TrainConfig("academy_empty_goal", observation=observation, **now)
    assert config_from_dict(values) == expected


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
        ({"num_envs": 0}, "num_envs is 0; it must be in \\[1, 1,000"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"clip_epsilon": -0.1}, "clip_epsilon is -0.1"),
        ({"critic_coeff": 0.0}, "critic_coeff is 0.0"),
        ({"entropy_coeff": float("inf")}, "entropy_coeff is inf"),
        ({"target_kl": 0.0}, "target_kl is 0.0; it must be a number above 0"),
        ({"entropy_coeff_end": -1.0}, "entropy_coeff_end is -1.0; it must be at least 0"),
        ({"value_loss": "l1"}, "value_loss is 'l1'; it must be one of l2, huber"),
        ({"gamma": 1.01}, r"gamma is 1.01; it must be in \[0, 1\]"),
        ({"minibatch_size": 1}, "minibatch_size is 1"),
        ({"minibatch_size": 5000}, r"in \[2, 2048\]"),
        ({"num_minibatches": 4096}, "at most 1024"),
    ],
)
def test_impossible_hyperparameters_are_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        PPOConfig(**changes).check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"network_options": {"hidden_sizes": ()}}, "hidden_sizes is ()"),
        ({"network_options": {"hidden_sizes": (64, 0)}}, "positive widths"),
        ({"seed": -1}, "seed is -1"),
        ({"num_threads": 0}, "num_threads is 0"),
        ({"eval_episodes": -1}, "eval_episodes is -1"),
        ({"checkpoint_interval": 0}, "checkpoint_interval is 0"),
        (
            {"network_options": {"activation": "swish"}},
            "activation is 'swish'; it must be one of relu, tanh",
        ),
        ({"collector": "processes"}, "collector is 'processes'; it must be one of threads, ray"),
        ({"mask": "engines"}, "Did you mean engine"),
        ({"network": "player_sets"}, "Did you mean player_set"),
        ({"network": "player_set"}, "the observation is simple115. Add --observation players"),
        (
            {"reward_options": {"transition": "possesion"}},
            "transition is 'possesion'; it must be one of possession, consecutive",
        ),
        ({"reward_options": {"episode_cap": -0.5}}, "episode_cap is -0.5"),
        ({"reward_options": {"episode_cap": float("inf")}}, "episode_cap is inf"),
        ({"reward_options": {"weight": "much"}}, "weight is 'much'; it must be of type float"),
        (
            {"reward": "potential", "reward_options": {"episode_cap": 0.5}},
            "The reward potential has no option 'episode_cap': it has density, weight",
        ),
        (
            {"reward": "scoring", "reward_options": {"density": "uniform"}},
            "The reward scoring has no option 'density': it has none",
        ),
        ({"mask_options": {"mask_idle": True}}, "there is no mask"),
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
