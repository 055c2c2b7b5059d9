"""gfootball's own environment with its own wrappers, as its users had it.

gfootball builds on gym 0.21, which no longer installs, and its wrappers fail on later ones. What
they need of gym is little: a base class that passes calls on, and two that convert what comes
back. Those stand in for gym here, without the checks that gym itself made at every call, so that
``gfootball.env.create_environment`` runs as installed and at its best speed.

Import this module in a process of its own: :mod:`fbrl.envs.engine` imports gfootball on another
stand-in for gym.
"""

from __future__ import annotations

import functools
import importlib
import sys
import types
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class _OldEnv:
    """``gym.Env``: ``reset()`` returns an observation, ``step()`` four values."""

    @property
    def unwrapped(self) -> Any:
        return self

    def close(self) -> None:
        pass


class _OldWrapper(_OldEnv):
    """``gym.Wrapper``: passes everything on to the environment that it wraps."""

    def __init__(self, env: Any) -> None:
        self.env = env

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.env, name)

    @property
    def unwrapped(self) -> Any:
        return self.env.unwrapped

    def reset(self) -> Any:
        return self.env.reset()

    def step(self, action: Any) -> Any:
        return self.env.step(action)

    def close(self) -> None:
        self.env.close()


class _OldObservationWrapper(_OldWrapper):
    """``gym.ObservationWrapper``: converts observations."""

    observation: Callable[[Any], Any]

    def reset(self) -> Any:
        return self.observation(self.env.reset())

    def step(self, action: Any) -> Any:
        observation, reward, done, info = self.env.step(action)
        return self.observation(observation), reward, done, info


class _OldRewardWrapper(_OldWrapper):
    """``gym.RewardWrapper``: converts rewards."""

    reward: Callable[[Any], Any]

    def step(self, action: Any) -> Any:
        observation, reward, done, info = self.env.step(action)
        return observation, self.reward(reward), done, info


@functools.cache
def _load_gfootball_env() -> types.ModuleType:
    gym = types.ModuleType("gym")
    registration = types.ModuleType("gym.envs.registration")
    vars(registration)["register"] = lambda **_: None
    vars(gym).update(
        Env=_OldEnv,
        Wrapper=_OldWrapper,
        ObservationWrapper=_OldObservationWrapper,
        RewardWrapper=_OldRewardWrapper,
        spaces=gymnasium.spaces,
    )
    stand_ins = {
        "gym": gym,
        "gym.spaces": gymnasium.spaces,
        "gym.envs": types.ModuleType("gym.envs"),
        "gym.envs.registration": registration,
    }
    sys.modules.update(stand_ins)
    try:
        module = importlib.import_module("gfootball.env")
    finally:
        # TorchRL and Stable-Baselines3 would take the stand-in for gym itself.
        for name in stand_ins:
            del sys.modules[name]
    wrappers = getattr(module, "wrappers", None)
    if wrappers is None or not issubclass(wrappers.SMMWrapper, _OldObservationWrapper):
        raise RuntimeError(
            "gfootball is already imported in this process, on another stand-in for gym: "
            "make its own environment in a process that has not imported fbrl.envs.engine's."
        )
    return module


def make_gfootball_env(
    scenario: str, representation: str, *, stacked: bool = False, seed: int | None = None
) -> Any:
    """The environment of gfootball itself for one controlled player, with the reward from goals.

    It has gym's old interface. The representation is ``"extracted"`` for its Super Mini Map, or
    ``"simple115v2"``; ``stacked`` stacks the last four. The seed is the engine's in every episode,
    drawn from Python's global ``random`` by default.
    """
    options = {} if seed is None else {"game_engine_random_seed": seed}
    return _load_gfootball_env().create_environment(
        scenario,
        representation=representation,
        stacked=stacked,
        rewards="scoring",
        other_config_options=options,
    )


class GFootballEnv(gymnasium.Env[np.ndarray, np.int64]):
    """The same with the interface of Gymnasium, which Stable-Baselines3 asks for."""

    def __init__(self, scenario: str, representation: str, stacked: bool) -> None:
        self._env = make_gfootball_env(scenario, representation, stacked=stacked)
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; gfootball takes its seed from Python's global ``random``."""
        return self._env.reset(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Plays one step; gfootball does not tell the time limit from other ends."""
        observation, reward, done, info = self._env.step(int(action))
        return observation, float(reward), done, False, info

    def close(self) -> None:
        """Frees the engine."""
        self._env.close()
