"""The engine seeds of an environment's episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from fbrl.envs.engine import FIRST_EPISODE, MAX_SEED

# gfootball draws its own seeds from this range: scenario_builder.py.
_LARGEST_DRAWN_SEED = 2_000_000_000


def check_seed(seed: Any) -> int:
    """Returns an engine seed.

    Raises:
        ValueError: It is not an integer in [0, 2**32 - 1].
    """
    is_integer = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
    if not is_integer or not 0 <= seed <= MAX_SEED:
        raise ValueError(f"Seed {seed!r} is not an integer in [0, {MAX_SEED}].")
    return int(seed)


def draw_seed(np_random: np.random.Generator) -> int:
    """An engine seed for an episode that was given none."""
    return int(np_random.integers(_LARGEST_DRAWN_SEED, endpoint=True))


def spread_seed(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """A seed for each of several matches: spawned from one, or as they are given.

    Raises:
        ValueError: A seed is out of range, or there are more or fewer seeds than matches.
    """
    if seed is None:
        return [None] * num_envs
    if isinstance(seed, (int, np.integer)):
        children = np.random.SeedSequence(check_seed(seed)).spawn(num_envs)
        return [int(child.generate_state(1)[0]) for child in children]
    is_list = isinstance(seed, (Sequence, np.ndarray)) and np.shape(seed) != ()  # type: ignore[arg-type]
    if not is_list or isinstance(seed, str):
        raise ValueError(f"Seed {seed!r} is neither an integer nor a list of {num_envs} integers.")
    if len(seed) != num_envs:
        raise ValueError(f"There are {len(seed)} seeds for {num_envs} matches.")
    return [None if one is None else check_seed(one) for one in seed]


class EpisodeSeeds:
    """Engine seeds and numbers of the episodes that one match after another plays.

    Attributes:
        engine_seed: Of the present episode.
        number: Of the present episode; its parity decides who kicks off.
    """

    def __init__(self) -> None:
        self._np_random = seeding.np_random()[0]
        self.engine_seed = 0
        self.number = FIRST_EPISODE - 1

    def advance(self, seed: int | None = None) -> None:
        """Goes on to the next episode, or to the first one of a seed."""
        if seed is None:
            self.engine_seed = draw_seed(self._np_random)
            self.number += 1
        else:
            self._np_random = seeding.np_random(seed)[0]
            self.engine_seed, self.number = seed, FIRST_EPISODE

    def get_state(self) -> dict[str, Any]:
        """What the next episodes depend on."""
        return {
            "engine_seed": self.engine_seed,
            "number": self.number,
            "np_random": self._np_random.bit_generator.state,
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state."""
        self.engine_seed, self.number = state["engine_seed"], state["number"]
        self._np_random.bit_generator.state = state["np_random"]
