"""Fixed episodes: what is played, from which seed, and with which actions."""

from __future__ import annotations

import bisect
import itertools
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace

NUM_ACTIONS = 19
BUILTIN_AI = 19
"""Index of gfootball's action set v2 that hands the player to the engine's own."""

_RIGHT, _TOP_RIGHT, _BOTTOM_RIGHT = 5, 4, 6
_SHORT_PASS, _SHOT, _SPRINT, _SLIDING = 11, 12, 13, 16

# How much likelier than the others some actions are; one of weight 0 is never taken.
_LIKELIER = {
    "random": {BUILTIN_AI: 0},
    "mixed": {},
    "attack": {
        BUILTIN_AI: 0,
        _RIGHT: 30,
        _TOP_RIGHT: 8,
        _BOTTOM_RIGHT: 8,
        _SHORT_PASS: 8,
        _SHOT: 12,
        _SPRINT: 8,
    },
    "builtin": {BUILTIN_AI: 170},
    "rough": {BUILTIN_AI: 24, _SLIDING: 20, _SPRINT: 8, _RIGHT: 6},
    "brutal": {BUILTIN_AI: 50, _SLIDING: 40, _SPRINT: 4},
}
BRUTAL = "brutal"
STYLES = tuple(style for style in _LIKELIER if style != BRUTAL)
"""How actions are drawn: evenly without and with the engine's own player, towards the goal, mostly
by the engine's own player, with many tackles; and, in BRUTAL, with hardly anything else."""


@dataclass(frozen=True)
class Episode:
    """One episode of a plan.

    Attributes:
        scenario: Name of a scenario module.
        seed: The engine's seed; its parity decides which team is processed first.
        number: Number of the episode; in full matches left kicks off in even ones.
        style: One of :data:`STYLES`.
        limit: It is left after so many steps, if it has not ended.
        states_every: Every so many steps a state is taken, and gone back to; 0 for never.
        left_agents: How many players of the left team get actions of their own; the others are the
            engine's.
        right_agents: Likewise.
        foul: Which one there is after some steps, as of :func:`~foul.with_foul`; 0 for none.
    """

    scenario: str
    seed: int
    number: int
    style: str
    limit: int = 10_000
    states_every: int = 0
    left_agents: int = 1
    right_agents: int = 0
    foul: int = 0

    def actions(self) -> Iterator[int]:
        """Endless actions, the same for each engine, NumPy and Python.

        Of Python's generator the numbers of ``random()`` are promised never to change; NumPy
        promises nothing of the kind.
        """
        weights = [_LIKELIER[self.style].get(action, 1) for action in range(NUM_ACTIONS + 1)]
        upto = list(itertools.accumulate(weights))
        generator = random.Random(self.seed * 64 + self.number)
        while True:
            yield bisect.bisect_right(upto, generator.random() * upto[-1])


def with_tackles(episode: Episode) -> Episode:
    """The episode with three players of each team controlled, who tackle all the time."""
    return replace(episode, style=BRUTAL, left_agents=3, right_agents=3)
