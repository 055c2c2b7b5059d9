"""Whichever football engine Python finds first, pip's gfootball or ours, without gym.

Nothing of fbrl is imported, so that pip's engine can be played from a directory of its own.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from dataclasses import dataclass
from typing import Any

from episodes import Episode
from small_pitch import SMALL_PITCH, build_scenario


@dataclass(frozen=True)
class AnyEngine:
    """The modules that matches are played with, and where the engine's lies."""

    engine: types.ModuleType
    config: types.ModuleType
    action_set: types.ModuleType

    @property
    def file(self) -> str:
        """Tells the engines apart."""
        return str(self.engine.__file__)

    def start(self) -> Any:
        """A started ``GameEnv``."""
        started = self.engine.GameEnv()
        started.start_game()
        return started

    def scenario(self, episode: Episode) -> Any:
        """The configuration of one episode; a reset changes it, so that it serves but once."""
        values = {
            "level": episode.scenario,
            "game_engine_random_seed": episode.seed,
            "players": [
                f"agent:left_players={episode.left_agents},right_players={episode.right_agents}"
            ],
            # gfootball adds one before it builds the scenario.
            "episode_number": episode.number - 1,
        }
        return self.config.Config(values).ScenarioConfig()


def load_engine() -> AnyEngine:
    """Imports what is needed of gfootball, past the packages' own code, which asks for gym."""
    spec = importlib.util.find_spec("gfootball")
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("There is no gfootball on Python's path.")
    (root,) = spec.submodule_search_locations
    for name, path in (("gfootball", root), ("gfootball.env", f"{root}/env")):
        package = types.ModuleType(name)
        package.__path__ = [path]
        sys.modules[name] = package
    loaded = AnyEngine(
        importlib.import_module("gfootball_engine"),
        importlib.import_module("gfootball.env.config"),
        importlib.import_module("gfootball.env.football_action_set"),
    )
    small_pitch = types.ModuleType(SMALL_PITCH)
    vars(small_pitch)["build_scenario"] = build_scenario
    sys.modules[f"gfootball.scenarios.{SMALL_PITCH}"] = small_pitch
    return loaded
