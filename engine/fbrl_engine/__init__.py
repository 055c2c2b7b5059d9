"""Google Research Football's engine: matches stepped by C++ threads, bit for bit gfootball's.

:class:`Matches` plays many of them. The classes of gfootball's own engine are here as well, under
their names, and the module ``gfootball_engine`` hands them to gfootball's Python modules.
"""

from __future__ import annotations

import weakref
from pathlib import Path

from fbrl_engine import _native
from fbrl_engine._native import FIELDS, MAX_PLAYERS, NUM_ACTIONS, Batch, Disturbance, Rows

__all__ = [
    "DATA",
    "FIELDS",
    "MAX_PLAYERS",
    "NUM_ACTIONS",
    "Batch",
    "Disturbance",
    "Matches",
    "Rows",
    "matches_in_hand",
]

DATA = Path(__file__).parent / "data"
"""What matches are played with: animations and the shapes of bodies."""

_all_matches: weakref.WeakSet[Matches] = weakref.WeakSet()


class Matches(_native.Matches):
    """Matches of one scenario, played by threads that hold no Python lock.

    An episode is prepared from its configuration, then begun, then stepped; a match that ends
    begins the next one at once if that is prepared. What is observed is written to arrays of the
    caller's, see :class:`Rows`. Work is sent for some matches and waited for later, so that other
    work can be done meanwhile.

    Args:
        scenario: Its name, for messages.
        num_matches: How many.
        num_threads: How many play them.
        frame_skip: How often 100 ms are played in a step; the action counts the first time, but for
            the engine's own player.

    Examples:
        >>> matches = Matches("academy_corner", num_matches=2, num_threads=2)
        >>> rows = Rows({"ball": numpy.zeros((2, 3), numpy.float32)})
        >>> for match in range(2):
        ...     matches.prepare(match, scenario_config, engine_seed=match, episode_number=2)
        >>> matches.send_begin([0, 1], rows).wait()
        >>> matches.send_step([0, 1], [5, 5], rows).wait()
    """

    def __init__(
        self, scenario: str, num_matches: int, num_threads: int, frame_skip: int = 1
    ) -> None:
        super().__init__(scenario, num_matches, num_threads, frame_skip, str(DATA))
        _all_matches.add(self)


def matches_in_hand() -> list[tuple[tuple[int, int], str]]:
    """What the threads of this process are playing now; may be asked by any thread.

    Returns:
        A key that no other step or reset has, and the match in words.
    """
    return [
        ((id(matches), number), match)
        for matches in list(_all_matches)
        for number, match in matches.in_hand()
    ]
