"""The football engine, gfootball's scenarios, and what the engine takes: actions, seeds, episodes.

The only module that imports the engine and gfootball, and without gfootball's own environments.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
import types
from dataclasses import dataclass
from typing import Any

from fbrl.envs.observation import MAX_DURATION, MAX_PLAYERS

NUM_ACTIONS = 19
BUILTIN_AI = NUM_ACTIONS
"""One more action, which lets the engine's own player decide; gfootball's action set v2 ends so."""

MAX_SEED = 2**32 - 1
"""The engine's seed is a C++ ``unsigned int``."""

FIRST_EPISODE = 2
"""Number of an environment's first episode, as in gfootball; left kicks off in even ones."""

FARTHEST = 100.0
"""Largest coordinate of a player or the ball, in pitch units; far beyond it they become NaN."""


class EngineNotInstalledError(ImportError):
    """Raised where a match is asked for and the engine can't be imported."""


class ScenarioError(ValueError):
    """Raised for a scenario's file that fails, or asks for what the engine can't play."""


@dataclass(frozen=True)
class GFootball:
    """What is in use: our package of gfootball's engine, and two of gfootball's Python modules."""

    engine: types.ModuleType
    config: types.ModuleType
    action_set: types.ModuleType


@functools.cache
def load_gfootball() -> GFootball:
    """Imports the engine, and of gfootball what builds scenarios: no gym, no OpenCV, no banner.

    Raises:
        EngineNotInstalledError: It, or something that it imports, is missing.
    """
    try:
        _import_bare("gfootball")
        _import_bare("gfootball.env")
        return GFootball(
            engine=importlib.import_module("fbrl_engine"),
            config=importlib.import_module("gfootball.env.config"),
            action_set=importlib.import_module("gfootball.env.football_action_set"),
        )
    except ImportError as error:
        raise EngineNotInstalledError(
            f"The football engine can't be imported ({error}). Run `make setup` in a clone of "
            "fbrl, which builds it with everything that it needs; `fbrl-doctor` checks the result."
        ) from error


def _import_bare(name: str) -> None:
    """Lets modules of a package be imported without what the package itself imports."""
    if name in sys.modules:
        return
    spec = importlib.util.find_spec(name)
    if spec is None or spec.submodule_search_locations is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    sys.modules[name] = importlib.util.module_from_spec(spec)


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
    if fault := _fault_of(config):
        raise ScenarioError(
            f"The scenario {scenario!r} can't be played: {fault}. Correct its file."
        )
    return config


def _fault_of(config: Any) -> str | None:
    """What a scenario asks of the engine that this takes, and then hangs with, or worse."""
    places = [("the ball", config.ball_position)]
    for side in ("left", "right"):
        team = list(getattr(config, f"{side}_team"))
        if not 1 <= len(team) <= MAX_PLAYERS:
            return f"the {side} team has {len(team)} players; it must be 1 to {MAX_PLAYERS}"
        # The engine takes the first for the keeper, and waits for it forever when the ball is out.
        role = team[0].role.name.removeprefix("e_PlayerRole_")
        if role != "GK":
            return (
                f"the {side} team's first player has the role {role}; it must be the keeper "
                "(e_PlayerRole_GK): add it before the others, far away if it shall not matter"
            )
        difficulty = getattr(config, f"{side}_team_difficulty")
        if not 0 <= difficulty <= 1:
            return f"{side}_team_difficulty is {difficulty:g}; it must be in [0, 1]"
        places += [(f"player {i} of the {side} team", p.position) for i, p in enumerate(team)]
    for what, position in places:
        x, y = position[0], position[1]
        if not (abs(x) <= FARTHEST and abs(y) <= FARTHEST):  # NaN neither
            return (
                f"{what} is at ({x:g}, {y:g}); it must be within {FARTHEST:g}; the pitch is "
                "[-1, 1] x [-0.42, 0.42]"
            )
    if not 1 <= config.game_duration <= MAX_DURATION:
        allowed = f"1 to {MAX_DURATION:,} steps"
        return f"game_duration is {config.game_duration}; it must be {allowed}"
    return None
