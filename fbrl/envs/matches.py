"""The engine's native matches, with the arrays that they write to.

The rules of a match are gfootball's, in the engine's ``src/match.cpp``. A match agrees step for
step with one that is played through gfootball's own Python environment.
"""

from __future__ import annotations

import contextlib
import gc
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from gymnasium import Space

from fbrl.checks import check_field_types
from fbrl.envs.engine import build_scenario, load_gfootball
from fbrl.envs.observation import OBSERVATION_SPACE

KEPT_STATES = 256
"""That :class:`MidwayStarts` keeps at most; 30 to 80 KB each."""

RESULTS = {"reward": np.float32, "terminated": np.bool_, "truncated": np.bool_}
"""What a step leads to besides an observation: the change of the goal difference, and whether a
rule of the scenario, or its time limit, ended the episode."""


@dataclass(frozen=True)
class MatchState:
    """Everything that decides how a match goes on."""

    seed: int
    """Engine seed that the episode began with."""
    episode_number: int
    """The episode's number."""
    engine: bytes
    """The engine's own state, its random numbers included; 30 to 80 KB."""
    waiting_steps: int
    """Steps since the game stopped, which the forced actions depend on."""
    previous_score_difference: int
    """Goals for minus goals against after the last step."""
    previous_game_mode: int
    """The game mode after the last step; -1 before the first one."""
    previous_ball_owned_team: int
    """The team that had the ball last; -1 if none had."""


@contextlib.contextmanager
def stating_what_is_no_match(state: str) -> Iterator[None]:
    """Makes of all that a wrong state leads to a ``ValueError``; the argument is its name."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"{state} is not that of a match ({reason}).") from error


_open_matches: weakref.WeakSet[Matches] = weakref.WeakSet()


def empty_arrays(spaces: Mapping[str, Space[Any]], *leading: int) -> dict[str, Any]:
    """Arrays of observation keys and of :data:`RESULTS`, whose shapes begin with ``leading``."""
    arrays = {key: np.zeros((*leading, *(s.shape or ())), s.dtype) for key, s in spaces.items()}
    return arrays | {key: np.zeros(leading, dtype) for key, dtype in RESULTS.items()}


class Matches:
    """Matches of one scenario, in each of which a player of the left team at a time is controlled.

    An episode is prepared, begun and stepped. A match that ends while the next one is prepared
    begins that at once, on the thread that stepped it.

    Args:
        scenario: Name of a scenario module in ``gfootball.scenarios``.
        num_matches: How many.
        num_threads: Of the engine.
        keys: What is observed, names in :data:`~fbrl.envs.observation.OBSERVATION_SPACE`.
        drawn_keys: What else :attr:`arrays` have, to be drawn.
        frame_skip: How often 100 ms are played in a step, at least 1.

    Attributes:
        arrays: What was observed last, shape (num_matches, ...) for each key, and of the last step
            :data:`RESULTS`, shape (num_matches,). The matches write to them, in each call anew.
        episodes: Engine seed and number of each match's episode.
    """

    def __init__(
        self,
        scenario: str,
        num_matches: int,
        num_threads: int,
        keys: Iterable[str],
        drawn_keys: Iterable[str] = (),
        frame_skip: int = 1,
    ) -> None:
        engine = load_gfootball().engine
        if _open_matches:
            # TorchRL's environments are reference cycles, which Python may not look for in a long
            # time: those that were dropped without close() hand their engines on first.
            gc.collect()
        _open_matches.add(self)
        self.scenario = scenario
        self.native = engine.Matches(scenario, num_matches, num_threads, frame_skip)
        self._keys = list(keys)
        spaces = {key: OBSERVATION_SPACE[key] for key in (*self._keys, *drawn_keys)}
        self.arrays = empty_arrays(spaces, num_matches)
        self.make_rows = engine.Rows
        self._rows = self.make_rows(self.arrays)
        self.episodes = [(0, 0)] * num_matches
        self._prepared = list(self.episodes)

    def prepare(self, match: int, seed: int, episode_number: int) -> None:
        """Says which episode a match begins next; see :func:`fbrl.envs.engine.build_scenario`."""
        config = build_scenario(self.scenario, seed, episode_number)
        self.native.prepare(match, config, seed, episode_number)
        self._prepared[match] = seed, episode_number

    def prepare_state(self, match: int, state: MatchState) -> None:
        """Says in which state of an earlier episode of this scenario a match begins next.

        From there it replays exactly. The engine takes a state as it is: one that was tampered with
        can do to the process whatever it wants. A ``TypeError`` for a value of another type.
        """
        check_field_types(state)
        # Which team is processed first, and who kicks off, is no part of the engine's state.
        config = build_scenario(self.scenario, state.seed, state.episode_number)
        values = asdict(state)
        episode = values.pop("seed"), values.pop("episode_number")
        self.native.prepare_state(match, config, *episode, **values)
        self._prepared[match] = episode

    def begin(self, matches: Sequence[int]) -> None:
        """Has these matches begin what is prepared, up to where the game is in play."""
        batch = self.native.send_begin(matches, self._rows)
        self.begun_anew(matches)
        batch.wait()

    def begun_anew(self, matches: Iterable[int]) -> None:
        """Notes that these matches have begun what was prepared for them."""
        for match in matches:
            self.episodes[match] = self._prepared[match]

    def step(self, matches: Sequence[int], actions: Sequence[int]) -> None:
        """Has these matches play 100 ms (ten physics steps), and on until the game is in play.

        That ``frame_skip`` times, or up to the episode's end; the action is played the first time
        alone, but for the engine's own player.
        Actions are indices in [0, 18], or :data:`~fbrl.envs.engine.BUILTIN_AI`. A ``RuntimeError``
        names a match that is not running, or that failed in the engine.
        """
        self.native.send_step(matches, actions, self._rows).wait()

    def observe(self) -> dict[str, Any]:
        """Copies of the arrays of the keys, shape (num_matches, ...)."""
        return {key: self.arrays[key].copy() for key in self._keys}

    def not_running(self) -> list[int]:
        """The matches whose episode has not begun or has ended."""
        native = self.native
        return [match for match in range(len(self.episodes)) if not native.is_running(match)]

    def get_state(self, match: int) -> MatchState:
        """The state of a running match; a ``RuntimeError`` for another."""
        seed, number = self.episodes[match]
        return MatchState(seed, number, **self.native.state(match))

    def set_state(self, match: int, state: MatchState) -> None:
        """Goes on from a state; what is none raises what :meth:`prepare_state` does."""
        self.prepare_state(match, state)
        self.begin([match])

    def close(self) -> None:
        """Ends the threads; the matches can't be used any more."""
        _open_matches.discard(self)
        self.native.close()


class MidwayStarts:
    """Lets a share of the matches, in (0, 1], begin in states that earlier ones came to.

    What pays is often far from where a scenario begins, and a policy that begins to learn seldom
    comes there. From the middle of earlier matches it is nearer (compare Salimans and Chen 2018,
    "Learning Montezuma's Revenge from a Single Demonstration", and Ecoffet et al. 2021, "First
    return, then explore").
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
