"""gfootball's modules, imported without gym.

The only module that imports gfootball; the others get what they need of it from
:func:`load_gfootball`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import gymnasium

_INSTALL_REMEDY = (
    "Run `make setup` in a clone of fbrl, which builds it with everything that it needs; "
    "`fbrl-doctor` checks the result."
)


class EngineNotInstalledError(ImportError):
    """Raised where a match is asked for and gfootball can't be imported."""


@dataclass(frozen=True)
class GFootball:
    """The parts of gfootball in use: its compiled engine and three of its Python modules."""

    engine: types.ModuleType
    config: types.ModuleType
    scenario_builder: types.ModuleType
    action_set: types.ModuleType


def _gym_stand_in() -> dict[str, types.ModuleType]:
    """Modules that gfootball finds under the name of gym, which is neither needed nor wanted."""
    gym = types.ModuleType("gym")
    for name in ("Env", "Wrapper", "ObservationWrapper", "RewardWrapper", "spaces"):
        setattr(gym, name, getattr(gymnasium, name))
    envs = types.ModuleType("gym.envs")
    registration = types.ModuleType("gym.envs.registration")
    # gfootball would otherwise put ids that can't be made into Gymnasium's registry.
    vars(registration)["register"] = lambda **_: None
    vars(gym)["envs"], vars(envs)["registration"] = envs, registration
    return {
        "gym": gym,
        "gym.spaces": gymnasium.spaces,
        "gym.envs": envs,
        "gym.envs.registration": registration,
    }


@contextlib.contextmanager
def _modules_replaced(replacements: Mapping[str, types.ModuleType]) -> Iterator[None]:
    before = {name: sys.modules.get(name) for name in replacements}
    sys.modules.update(replacements)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


@functools.cache
def load_gfootball() -> GFootball:
    """Imports gfootball without gym: no banner, nothing registered, no pygame window.

    Raises:
        EngineNotInstalledError: gfootball, or something that it imports, is missing.
    """
    try:
        with _modules_replaced(_gym_stand_in()):
            return GFootball(
                engine=importlib.import_module("gfootball_engine"),
                config=importlib.import_module("gfootball.env.config"),
                scenario_builder=importlib.import_module("gfootball.env.scenario_builder"),
                action_set=importlib.import_module("gfootball.env.football_action_set"),
            )
    except ImportError as error:
        raise EngineNotInstalledError(
            f"The football engine can't be imported ({error}). {_INSTALL_REMEDY}"
        ) from error
