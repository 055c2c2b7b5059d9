"""A curriculum over where matches begin: in states that earlier ones came to."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from fbrl.envs.matches import MatchState

KEPT_STATES = 256
"""The latest ones; 30 to 80 KB each."""


class MidwayStarts:
    """Lets a share of the matches begin in states that earlier matches came to.

    What pays is often far from where a scenario begins, and a policy that begins to learn seldom
    comes there. From the middle of earlier matches it is nearer, and the better the policy is, the
    nearer are they to the goal (compare Salimans and Chen 2018, "Learning Montezuma's Revenge from
    a Single Demonstration", and Ecoffet et al. 2021, "First return, then explore").

    Args:
        share: Of the matches that begin midway, above 0 and at most 1.

    Raises:
        ValueError: It is not.
    """

    def __init__(self, share: float) -> None:
        if not 0 < share <= 1:
            raise ValueError(f"midway_starts is {share}; it must be a share of 0 to 1.")
        self._share = share
        self._states: deque[MatchState] = deque(maxlen=KEPT_STATES)

    def keep(self, states: Iterable[MatchState]) -> None:
        """Keeps states of matches that go on, instead of the oldest ones."""
        self._states.extend(states)

    def kept(self) -> tuple[MatchState, ...]:
        """The states that are kept, the oldest first."""
        return tuple(self._states)

    def choose(self, engine_seed: int) -> MatchState | None:
        """Where the match begins that would otherwise begin with this seed; None: as it would.

        The same as long as no state is kept meanwhile.
        """
        np_random = np.random.default_rng(engine_seed)
        if not self._states or np_random.random() >= self._share:
            return None
        return self._states[np_random.integers(len(self._states))]
