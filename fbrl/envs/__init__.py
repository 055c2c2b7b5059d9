"""Football matches as Gymnasium environments, and their assembly with transforms.

Importing this package imports neither gfootball nor TorchRL; making an environment does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fbrl.checks import UnknownNameError
from fbrl.envs.actions import ACTION_NAMES
from fbrl.envs.engine import EngineNotInstalledError, ScenarioError
from fbrl.envs.football import FootballEnv
from fbrl.envs.observation import OBSERVATION_SPACE
from fbrl.envs.vector_env import FootballVectorEnv
from fbrl.scenarios import SCENARIOS, Scenario

if TYPE_CHECKING:
    from fbrl.envs.factory import make_env

__all__ = [
    "ACTION_NAMES",
    "OBSERVATION_SPACE",
    "SCENARIOS",
    "EngineNotInstalledError",
    "FootballEnv",
    "FootballVectorEnv",
    "Scenario",
    "ScenarioError",
    "UnknownNameError",
    "make_env",
]


def __getattr__(name: str) -> Any:
    # TorchRL takes seconds to import, which plain Gymnasium users need not wait for.
    if name == "make_env":
        from fbrl.envs.factory import make_env

        return make_env
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
