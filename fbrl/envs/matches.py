"""The engine's native matches, with the arrays that they write to.

The rules of a match are gfootball's, in the engine's ``src/match.cpp``: forced actions while the
game waits, the ends of an episode, the score reward. A match agrees step for step with one that is
played through gfootball's own Python environment.
"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from gymnasium import Space

from fbrl.checks.field_types import check_field_types
from fbrl.envs.engine import build_scenario
from fbrl.envs.gfootball_import import load_gfootball
from fbrl.envs.observation import OBSERVATION_SPACE

RESULTS = {"reward": np.float32, "terminated": np.bool_, "truncated": np.bool_}
"""What a step leads to besides an observation."""


@dataclass(frozen=True)
class MatchState:
    """Everything that decides how a match goes on.

    Attributes:
        seed: Engine seed that the episode began with.
        episode_number: Its number.
        engine: The engine's own state, its random numbers included; 30 to 80 KB.
        waiting_steps: Steps since the game stopped, which the forced actions depend on.
        previous_score_difference: Goals for minus goals against after the last step.
        previous_game_mode: Its game mode; -1 before the first step.
        previous_ball_owned_team: The team that had the ball last; -1 if none had.
    """

    seed: int
    episode_number: int
    engine: bytes
    waiting_steps: int
    previous_score_difference: int
    previous_game_mode: int
    previous_ball_owned_team: int


_open_matches: weakref.WeakSet[Matches] = weakref.WeakSet()


def empty_arrays(spaces: Mapping[str, Space[Any]], *leading: int) -> dict[str, Any]:
    """Arrays for matches to write to: of each observation key, and of :data:`RESULTS`.

    Args:
        spaces: Of the observation keys.
        leading: What the arrays' shapes begin with.
    """
    arrays = {key: np.zeros((*leading, *(s.shape or ())), s.dtype) for key, s in spaces.items()}
    return arrays | {key: np.zeros(leading, dtype) for key, dtype in RESULTS.items()}


class Matches:
    """Matches of one scenario, in each of which a player of the left team at a time is controlled.

    An episode is prepared, begun and stepped. A match that ends while the next one is prepared
    begins that at once, on the thread that stepped it.

    Args:
        scenario: Name of a scenario module in ``gfootball.scenarios``.
        num_matches: How many.
        num_threads: How many threads play them, without Python's lock.
        keys: What is observed, names in :data:`~fbrl.envs.observation.OBSERVATION_SPACE`.
        drawn_keys: What else :attr:`arrays` have, to be drawn.

    Attributes:
        arrays: What was observed last, shape (num_matches, ...) for each key. Besides, of the last
            step: ``reward``, the change of the goal difference, float32; ``terminated``, whether a
            rule of the scenario ended the episode, and ``truncated``, whether its time limit did;
            shape (num_matches,). The matches write to them, in each call anew.
        episodes: Engine seed and number of each match's episode.

    Raises:
        EngineNotInstalledError: The engine can't be imported.
    """

    def __init__(
        self,
        scenario: str,
        num_matches: int,
        num_threads: int,
        keys: Iterable[str],
        drawn_keys: Iterable[str] = (),
    ) -> None:
        engine = load_gfootball().engine
        if _open_matches:
            # TorchRL's environments are reference cycles, which Python may not look for in a long
            # time: those that were dropped without close() hand their engines on first.
            gc.collect()
        _open_matches.add(self)
        self.scenario = scenario
        self.native = engine.Matches(scenario, num_matches, num_threads)
        self._keys = list(keys)
        spaces = {key: OBSERVATION_SPACE[key] for key in (*self._keys, *drawn_keys)}
        self.arrays = empty_arrays(spaces, num_matches)
        self.make_rows = engine.Rows
        self._rows = self.make_rows(self.arrays)
        self.episodes = [(0, 0)] * num_matches
        self._prepared = list(self.episodes)

    def prepare(self, match: int, seed: int, episode_number: int) -> None:
        """Says which episode a match begins next; see :func:`fbrl.envs.engine.build_scenario`.

        Raises:
            ScenarioError: The engine can't play the scenario, or its file fails.
        """
        config = build_scenario(self.scenario, seed, episode_number)
        self.native.prepare(match, config, seed, episode_number)
        self._prepared[match] = seed, episode_number

    def prepare_state(self, match: int, state: MatchState) -> None:
        """Says in which state of an earlier episode a match begins next.

        Args:
            match: The one that goes on from it, and then replays exactly, whatever was played
                since.
            state: Of a match of this scenario. The engine takes it as it is: one that was tampered
                with can do to the process whatever it wants.

        Raises:
            TypeError: A value in it is of another type.
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
        """Notes that these matches have gone on to the episodes that were prepared for them."""
        for match in matches:
            self.episodes[match] = self._prepared[match]

    def step(self, matches: Sequence[int], actions: Sequence[int]) -> None:
        """Has these matches play 100 ms (ten physics steps), and on until the game is in play.

        Args:
            matches: Running ones.
            actions: Of each an index into gfootball's default action set, in [0, 18], or
                :data:`~fbrl.envs.engine.BUILTIN_AI`.

        Raises:
            RuntimeError: One is not running, or failed in the engine; the message names it.
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
        """The state of a running match.

        Raises:
            RuntimeError: It is not running.
        """
        seed, number = self.episodes[match]
        return MatchState(seed, number, **self.native.state(match))

    def set_state(self, match: int, state: MatchState) -> None:
        """Goes on from a state, see :meth:`prepare_state`.

        Raises:
            ValueError: It is not the state of such a match, as far as can be seen.
            TypeError: A value in it is of another type.
        """
        self.prepare_state(match, state)
        self.begin([match])

    def close(self) -> None:
        """Ends the threads; the matches can't be used any more."""
        _open_matches.discard(self)
        self.native.close()
