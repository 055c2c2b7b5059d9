"""What the football engine takes: actions, seeds, episode numbers, scenarios."""

from __future__ import annotations

import importlib
from typing import Any

from fbrl.envs.gfootball_import import load_gfootball
from fbrl.envs.scenario_check import ScenarioError, check_scenario_config

NUM_ACTIONS = 19
BUILTIN_AI = NUM_ACTIONS
"""One more action, which lets the engine's own player decide; gfootball's action set v2 ends so."""

MAX_SEED = 2**32 - 1
"""The engine's seed is a C++ ``unsigned int``."""

FIRST_EPISODE = 2
"""Number of an environment's first episode, as in gfootball; left kicks off in even ones."""


def build_scenario(scenario: str, seed: int, episode_number: int) -> Any:
    """Builds the configuration of one episode.

    Args:
        scenario: Name of a scenario module in ``gfootball.scenarios``.
        seed: Engine seed in [0, 2**32 - 1]; its parity decides which team the engine processes
            first. Scenarios marked deterministic ignore it.
        episode_number: In scenarios with a kick-off the left team has it in even episodes.

    Raises:
        EngineNotInstalledError: The engine can't be imported.
        ScenarioError: The scenario's file fails, or asks for what the engine can't play.
    """
    values = {
        "level": scenario,
        "game_engine_random_seed": seed,
        # gfootball adds one before it builds the scenario.
        "episode_number": episode_number - 1,
    }
    make_config = load_gfootball().config.Config
    try:
        # Before gfootball does it, which answers what can't be imported by ending the process.
        importlib.import_module(f"gfootball.scenarios.{scenario}")
        config = make_config(values).ScenarioConfig()
    except Exception as error:  # it is the user's own code
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise ScenarioError(
            f"The file of the scenario {scenario!r} fails ({reason}). Correct it."
        ) from error
    check_scenario_config(scenario, config)
    return config
