"""Made-up matches in which the ball changes hands often, as data and as a TorchRL environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

INTEGERS = ("ball_owned_team", "ball_owned_player", "active", "game_mode")


def random_state(random: np.random.Generator) -> dict[str, Any]:
    """A state of a match; the controlled player has the ball in about every third one."""
    return {
        "ball": random.uniform([-1.1, -0.5, 0], [1.1, 0.5, 2]).astype(np.float32),
        "ball_owned_team": int(random.choice([-1, 0, 0, 0, 0, 1])),
        "ball_owned_player": int(random.integers(0, 2)),
        "active": int(random.integers(0, 2)),
        "game_mode": int(random.choice([0, 0, 0, 0, 0, 0, 3])),
    }


def random_scoring(random: np.random.Generator) -> float:
    return float(random.choice([0, 0, 0, 0, 0, 0, 0, 0, 1, -1]))


@st.composite
def states(draw: st.DrawFn) -> dict[str, Any]:
    """Any state, with the ball also on the lines, outside the pitch, or nowhere."""
    x = st.sampled_from([-1.0, 1.0, 1.01, float("nan")]) | st.floats(-1.25, 1.25, width=32)
    y = st.sampled_from([-0.42, 0.42, 0.43, float("nan")]) | st.floats(-0.5, 0.5, width=32)
    return {
        "ball": np.array([draw(x), draw(y), 0.0], np.float32),
        "ball_owned_team": draw(st.sampled_from([0, 0, 0, -1, 1])),
        "ball_owned_player": draw(st.integers(-1, 2)),
        "active": draw(st.integers(0, 2)),
        "game_mode": draw(st.sampled_from([0, 0, 0, 4])),
    }


def scorings() -> st.SearchStrategy[float]:
    return st.sampled_from([0.0, 0.0, 0.0, 1.0, -1.0])


@st.composite
def episodes(draw: st.DrawFn) -> tuple[dict[str, Any], list[tuple[dict[str, Any], float]]]:
    """A first state, and the state and the scoring reward of every step."""
    steps = draw(st.lists(st.tuples(states(), scorings()), min_size=1, max_size=12))
    return draw(states()), steps


def as_entries(chosen: list[dict[str, Any]]) -> dict[str, torch.Tensor]:
    return {
        "ball": torch.from_numpy(np.stack([state["ball"] for state in chosen])),
        **{key: torch.tensor([state[key] for state in chosen]) for key in INTEGERS},
    }


def stored_trajectory(played: list[Any]) -> TensorDict:
    """Episodes one after the other along one time dimension, as a collector stores them."""
    before, after, scoring, done = [], [], [], []
    for first, steps in played:
        before += [first, *(state for state, _ in steps[:-1])]
        after += [state for state, _ in steps]
        scoring += [reward for _, reward in steps]
        done += [False] * (len(steps) - 1) + [True]
    following = {
        **as_entries(after),
        "reward": torch.tensor(scoring).unsqueeze(-1),
        "done": torch.tensor(done).unsqueeze(-1),
    }
    return TensorDict(
        {**as_entries(before), "next": TensorDict(following, [len(after)])},
        [len(after)],
        names=["time"],
    )


class ScriptedMatches(EnvBase):
    """Matches that end after different numbers of steps; a state depends on where it is alone.

    At a partial reset, the matches that go on are observed as nonsense: whoever reads those rows
    shows it.

    Args:
        lengths: episode length of each match.
        batched: whether the batch size is ``[len(lengths)]`` or, for one match, ``[]``.
        seed: of all states.
    """

    def __init__(
        self, lengths: tuple[int, ...] = (3, 5, 8), *, batched: bool = True, seed: int = 0
    ) -> None:
        shape = torch.Size([len(lengths)] if batched else [])
        super().__init__(device=torch.device("cpu"), batch_size=shape)
        self.lengths = lengths
        self.seed = seed
        self.episode = [-1] * len(lengths)
        self.time = [0] * len(lengths)
        integer = {key: Unbounded(shape, dtype=torch.int64) for key in INTEGERS}
        self.observation_spec = Composite(ball=Unbounded((*shape, 3)), **integer, shape=shape)
        self.reward_spec = Unbounded((*shape, 1))
        self.action_spec = Categorical(2, shape=shape)
        self.full_done_spec = Composite(
            done=Categorical(2, shape=(*shape, 1), dtype=torch.bool), shape=shape
        )

    def _randoms(self) -> list[np.random.Generator]:
        where = zip(range(len(self.lengths)), self.episode, self.time, strict=True)
        return [np.random.default_rng([self.seed, *place]) for place in where]

    def _result(self, chosen: list[dict[str, Any]], **others: torch.Tensor) -> TensorDict:
        entries = {**as_entries(chosen), **others}
        if not self.batch_size:
            entries = {key: value.squeeze(0) for key, value in entries.items()}
        return TensorDict(entries, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        chosen = [True] * len(self.lengths) if mask is None else mask.flatten().tolist()
        for match, reset in enumerate(chosen):
            if reset:
                self.episode[match] += 1
                self.time[match] = 0
        nonsense = {"ball": np.zeros(3, np.float32), **dict.fromkeys(INTEGERS, 0), "active": 9}
        nonsense["ball_owned_player"] = 9
        randoms = self._randoms()
        states = [
            random_state(random) if reset else nonsense
            for random, reset in zip(randoms, chosen, strict=True)
        ]
        return self._result(states)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.time = [time + 1 for time in self.time]
        randoms = self._randoms()
        states = [random_state(random) for random in randoms]
        reward = torch.tensor([[random_scoring(random)] for random in randoms])
        ended = [t >= n for t, n in zip(self.time, self.lengths, strict=True)]
        return self._result(states, reward=reward, done=torch.tensor(ended).unsqueeze(-1))

    def _set_seed(self, seed: int | None) -> None:
        pass
