"""gfootball's own Python environment, as installed, to compare ours with."""

from __future__ import annotations

import importlib
import random
import sys
import types
from typing import Any

import gymnasium
import numpy as np
import pytest

from fbrl.envs.engine import load_gfootball


def import_gfootball(name: str) -> Any:
    """A module of gfootball's that imports gym, with gymnasium in gym's place."""
    load_gfootball()
    gym = types.ModuleType("gym")
    for attribute in ("Env", "Wrapper", "ObservationWrapper", "RewardWrapper", "spaces"):
        setattr(gym, attribute, getattr(gymnasium, attribute))
    with pytest.MonkeyPatch.context() as patch:
        # TorchRL would take it for the real one, if it stayed.
        patch.setitem(sys.modules, "gym", gym)
        return importlib.import_module(f"gfootball.env.{name}")


def make_gfootball_env(scenario: str, seed: int | None) -> Any:
    """gfootball's ``FootballEnv`` for one controlled left player, with its engine seed pinned."""
    config = load_gfootball().config
    values: dict[str, Any] = {"level": scenario}
    if seed is not None:
        values["game_engine_random_seed"] = seed
    football_env = import_gfootball("football_env")
    state = random.getstate()
    env = football_env.FootballEnv(config.Config(values))
    random.setstate(state)
    return env


def pad(key: str, value: Any) -> np.ndarray:
    """A raw observation of gfootball in the padded form that our environments document."""
    array = np.asarray(value)
    is_per_player = key.startswith(("left_team", "right_team"))
    if not is_per_player or len(array) == 11:
        return array
    fill = 0 if key.endswith(("tired_factor", "yellow_card", "active")) else -1
    missing = [(0, 11 - len(array))] + [(0, 0)] * (array.ndim - 1)
    return np.pad(array.astype(float), missing, constant_values=fill)


def shoot_near_goal(step: int, ball_x: float) -> int:
    """A simple attacker: runs right with a sprint, and shoots in the last fifth of the pitch."""
    if ball_x > 0.6:
        return 12
    return 13 if step % 7 == 0 else 5
