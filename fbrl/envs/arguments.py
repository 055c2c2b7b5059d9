"""What ``reset`` and ``step`` are given, and the engine seeds that follow from it.

The checks return what they are given, as an array or an integer, or raise a ``ValueError``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from fbrl.envs.engine import FIRST_EPISODE, MAX_SEED

# gfootball draws its own seeds from this range: scenario_builder.py.
_LARGEST_DRAWN_SEED = 2_000_000_000


def check_options(options: Any, known: tuple[str, ...]) -> Mapping[str, Any]:
    """The options of a reset, of which only some are known; none of them for ``None``."""
    if options is None:
        return {}
    if not isinstance(options, Mapping) or not set(options) <= set(known):
        allowed = " and ".join(known) or "none"
        raise ValueError(f"The options of reset() are {options!r}; allowed: {allowed}.")
    return options


def check_mask(mask: Any, num_envs: int) -> np.ndarray:
    """The mask of a reset, bool (num_envs,); true everywhere for ``None``."""
    if mask is None:
        return np.ones(num_envs, bool)
    return _as_array("reset_mask", mask, num_envs, np.bool_, "boolean")


def check_actions(actions: Any, num_envs: int, num_actions: int) -> np.ndarray:
    """The actions of a step, integers in [0, num_actions - 1] of shape (num_envs,)."""
    actions = _as_array("actions", actions, num_envs, np.integer, "integers")
    if actions.min() < 0 or actions.max() >= num_actions:
        raise ValueError(f"Actions {actions.tolist()} are not all in [0, {num_actions - 1}].")
    return actions


def _as_array(name: str, values: Any, num_envs: int, kind: Any, in_words: str) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name}: {values!r} are rows which make no array.") from error
    if array.shape != (num_envs,) or not np.issubdtype(array.dtype, kind):
        raise ValueError(
            f"{name} has shape {array.shape} and dtype {array.dtype}; it must be {in_words} of "
            f"shape ({num_envs},)."
        )
    return array


def check_seed(seed: Any) -> int:
    """An engine seed, in [0, 2**32 - 1]."""
    is_integer = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
    if not is_integer or not 0 <= seed <= MAX_SEED:
        raise ValueError(f"Seed {seed!r} is not an integer in [0, {MAX_SEED}].")
    return int(seed)


def spread_seed(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """A seed for each of several matches: spawned from one, or as they are given."""
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


def draw_seed(np_random: np.random.Generator) -> int:
    """An engine seed for an episode that was given none."""
    return int(np_random.integers(_LARGEST_DRAWN_SEED, endpoint=True))


class EpisodeSeeds:
    """Engine seed and number of a match's episode, and what the next ones follow from."""

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
        state = self._np_random.bit_generator.state
        return {"engine_seed": self.engine_seed, "number": self.number, "np_random": state}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state."""
        self.engine_seed, self.number = state["engine_seed"], state["number"]
        self._np_random.bit_generator.state = state["np_random"]
