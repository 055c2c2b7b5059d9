"""Made-up matches: observations in gfootball's raw form and in ours, and an environment of them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tensordict import TensorDict

PER_PLAYER = ("", "_direction", "_roles")


def coordinates(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Single-precision floats, as the engine has them, widened to double as gfootball does."""
    on_or_near_the_pitch = st.floats(-1.25, 1.25, width=32)
    anywhere = st.floats(-(2.0**20), 2.0**20, width=32)
    return hnp.arrays(np.float64, shape, elements=on_or_near_the_pitch | anywhere)


@st.composite
def raw_matches(draw: st.DrawFn) -> dict[str, Any]:
    """A raw observation as gfootball gives it: teams have as many rows as players."""
    num_left, num_right = draw(st.integers(1, 11)), draw(st.integers(0, 11))
    raw: dict[str, Any] = {
        "ball": draw(coordinates(3)),
        "ball_direction": draw(coordinates(3)),
        "active": draw(st.integers(-1, num_left - 1)),
        "ball_owned_team": draw(st.integers(-1, 1)),
        "game_mode": draw(st.integers(0, 6)),
    }
    for team, num_players in (("left_team", num_left), ("right_team", num_right)):
        raw[team] = draw(coordinates(num_players, 2))
        raw[f"{team}_direction"] = draw(coordinates(num_players, 2))
        raw[f"{team}_roles"] = draw(hnp.arrays(np.int64, num_players, elements=st.integers(0, 9)))
    return raw


def random_match(
    random: np.random.Generator, num_left: int = 11, num_right: int = 11
) -> dict[str, Any]:
    """A raw observation with players all over the pitch and slightly outside of it."""

    def draw(*shape: int) -> np.ndarray:
        return random.uniform(-1.1, 1.1, shape).astype(np.float32).astype(np.float64)

    raw: dict[str, Any] = {
        "ball": draw(3),
        "ball_direction": draw(3),
        "active": int(random.integers(-1, num_left)),
        "ball_owned_team": int(random.integers(-1, 2)),
        "game_mode": int(random.integers(7)),
    }
    for team, num_players in (("left_team", num_left), ("right_team", num_right)):
        raw[team] = draw(num_players, 2)
        raw[f"{team}_direction"] = draw(num_players, 2)
        raw[f"{team}_roles"] = random.integers(0, 10, num_players)
    return raw


def padded(raw: dict[str, Any]) -> dict[str, np.ndarray]:
    """A raw observation in the form of ours: padded with -1 to eleven players, single precision."""
    result = {}
    for key, value in raw.items():
        array = np.asarray(value)
        if key.startswith(("left_team", "right_team")):
            missing = [(0, 11 - len(array))] + [(0, 0)] * (array.ndim - 1)
            array = np.pad(array, missing, constant_values=-1)
        result[key] = array.astype(np.float32 if array.dtype.kind == "f" else np.int64)
    return result


def as_tensordict(*raws: dict[str, Any]) -> TensorDict:
    """The observations of several matches, batch size ``[len(raws)]``."""
    matches = [padded(raw) for raw in raws]
    return TensorDict(
        {key: torch.tensor(np.stack([match[key] for match in matches])) for key in matches[0]},
        batch_size=[len(raws)],
    )


def _match_space() -> spaces.Dict:
    example = padded(random_match(np.random.default_rng(0)))
    return spaces.Dict(
        {
            key: spaces.Box(-np.inf, np.inf, value.shape, np.float32)
            if value.dtype == np.float32
            else spaces.Box(-1, 10, value.shape, np.int64)
            for key, value in example.items()
        }
    )


class SyntheticVectorEnv(VectorEnv[Any, Any, Any]):
    """Matches of made-up observations that end after different numbers of steps.

    The observation depends on the match, its episode and the step in the episode alone.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012

    def __init__(self, lengths: tuple[int, ...] = (2, 3, 7)) -> None:
        self.lengths = lengths
        self.num_envs = len(lengths)
        self.autoreset_mode = AutoresetMode.DISABLED
        self.single_observation_space = _match_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.single_action_space = spaces.Discrete(19)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.episodes = [0] * self.num_envs
        self.steps = [0] * self.num_envs

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[dict[str, Any], dict]:
        mask = (options or {}).get("reset_mask")
        for index in range(self.num_envs):
            if mask is None or mask[index]:
                self.episodes[index] += 1
                self.steps[index] = 0
        return self._observe(), {}

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Any, Any, dict]:
        self.steps = [step + 1 for step in self.steps]
        ended = np.array([s >= n for s, n in zip(self.steps, self.lengths, strict=True)])
        nothing = np.zeros(self.num_envs)
        return self._observe(), nothing.astype(np.float32), ended, nothing.astype(bool), {}

    def _observe(self) -> dict[str, np.ndarray]:
        identities = zip(range(self.num_envs), self.episodes, self.steps, strict=True)
        matches = [padded(random_match(np.random.default_rng(i), 11, 4)) for i in identities]
        return {key: np.stack([match[key] for match in matches]) for key in matches[0]}


class SyntheticEnv(gymnasium.Env[Any, Any]):
    """One match of :class:`SyntheticVectorEnv`."""

    def __init__(self, length: int = 3) -> None:
        self._matches = SyntheticVectorEnv((length,))
        self.observation_space = self._matches.single_observation_space
        self.action_space = self._matches.single_action_space

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[dict[str, Any], dict]:
        super().reset(seed=seed)
        observation, _ = self._matches.reset()
        return {key: value[0] for key, value in observation.items()}, {}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict]:
        observation, _, ended, _, _ = self._matches.step([action])
        return {key: value[0] for key, value in observation.items()}, 0.0, bool(ended[0]), False, {}
