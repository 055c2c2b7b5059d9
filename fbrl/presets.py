"""Configurations to begin with: the light one, one that learns more, and that of the thesis."""

from __future__ import annotations

import dataclasses

from fbrl.checks import check_name
from fbrl.config import PPOConfig, TrainConfig
from fbrl.registry import check_types
from fbrl.scenarios import SCENARIOS

PRESETS = {
    "light": "simple115 and a small network, trains at the engine's speed on a CPU",
    "strong": "players, the potential and a learner for its small rewards; counterattacks "
    "want --initial-weights pretrained:academy_3_vs_1_with_keeper besides",
    "thesis": "mini map, IMPALA network and Table 5.1; wants a GPU",
}
"""What each is."""

# experiments/learning: what learned 3 against 1, and both counterattacks from weights of another
# training.
_STRONG = PPOConfig(
    num_envs=32,
    num_steps=128,
    num_minibatches=4,
    num_epochs=6,
    target_kl=0.02,
    learning_rate=5e-4,
    anneal_learning_rate=False,
    entropy_coeff_end=0.0,
    normalize_reward=True,
)

# Table 5.1 of the thesis; the row of the full matches differs in four values.
_THESIS_ACADEMY = PPOConfig(
    num_steps=512,
    num_minibatches=8,
    num_epochs=2,
    learning_rate=3.43e-4,
    gamma=0.993,
    gae_lambda=0.95,
    clip_epsilon=0.08,
    entropy_coeff=0.00155,
    critic_coeff=0.5,
    max_grad_norm=0.64,
)
_THESIS_FULL_MATCH = dataclasses.replace(
    _THESIS_ACADEMY, total_frames=5_000_000, num_steps=1024, num_minibatches=64, num_epochs=4
)


def preset_config(preset: str, scenario: str) -> TrainConfig:
    """The configuration that a preset gives for a scenario; light has the defaults.

    The thesis has other hyperparameters for 11 against 11, and matches of 3000 steps are evaluated
    less often and with fewer of them.

    Raises:
        UnknownNameError: There is no preset of this name.
        ConfigError: The scenario is no text.
    """
    check_name("preset", preset, PRESETS)
    config = TrainConfig(scenario)
    check_types(config)
    if preset == "strong":
        config = dataclasses.replace(config, observation="players", reward="potential", ppo=_STRONG)
    if preset == "thesis":
        is_full_match = scenario.startswith("11_vs_11")
        ppo = _THESIS_FULL_MATCH if is_full_match else _THESIS_ACADEMY
        config = dataclasses.replace(config, observation="minimap", ppo=ppo)
    if scenario in SCENARIOS and SCENARIOS[scenario].duration >= 3000:
        config = dataclasses.replace(config, eval_episodes=16, eval_interval=500_000)
    return config


def nearest_preset(config: TrainConfig) -> str:
    """The preset that shares most values with a configuration."""

    def shared(preset: str) -> int:
        base = preset_config(preset, config.scenario)
        its = vars(base) | vars(base.ppo)
        return sum(its[name] == value for name, value in (vars(config) | vars(config.ppo)).items())

    return max(PRESETS, key=shared)
