"""Plays fixed episodes on whichever engine Python finds first, and prints a JSON line for each.

    PYTHONPATH=DIRECTORY python engine/tests/play_matches.py < EPISODES > RESULTS

Each line of EPISODES is an :class:`~episodes.Episode` in JSON. They are played one after another
on one engine, by gfootball's rules. The first line of RESULTS says which engine it was; each other
one has the hashes of all that was to be seen of an episode, its events, and how it ended.

The last line says that it is the last. With ``--trace N`` the numbers of each step of the Nth episode
(from 0) are printed as well.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import sys
from array import array
from collections.abc import Callable
from itertools import chain
from typing import Any, TextIO

from any_engine import AnyEngine, load_engine
from episodes import Episode
from events import EventCounter
from match_rules import MatchRules
from observation import Numbers, observed_numbers, other_numbers
from state_layout import foul_type, hide_uninitialised

_REPLAYED_STEPS = 15


class RecordedEpisode:
    """Plays one episode and records it.

    Args:
        loaded: The engine's modules.
        game: A started ``GameEnv``.
        episode: What to play.
        trace: Called with the numbers after each step, for whoever looks for a difference.
    """

    def __init__(
        self,
        loaded: AnyEngine,
        game: Any,
        episode: Episode,
        trace: Callable[[Numbers], None] | None = None,
    ) -> None:
        self.rules = MatchRules(loaded, game, self._see)
        self._game = game
        self._episode = episode
        self._trace = trace
        self._actions = episode.actions()
        self._played: list[int] = []
        self._observed, self._rest, self._states = (hashlib.sha256() for _ in range(3))
        self._events = EventCounter(lambda: foul_type(game.get_state("")) == 0)
        self._engine_steps = 0
        self._replays: list[bool] = []

    def play(self) -> dict[str, Any]:
        """Plays the episode from its first to its last step."""
        episode = self._episode
        self.rules.reset(episode.scenario, episode.seed, episode.number)
        steps = self.go_on(episode.limit)
        return {
            **dataclasses.asdict(episode),
            "steps": steps,
            "engine_steps": self._engine_steps,
            **self.hashes(),
            "end": self.rules.end or "left",
            "events": {name: count for name, count in self._events.counts.items() if count},
            "replays": [len(self._replays), sum(self._replays)],
        }

    def go_on(self, steps: int) -> int:
        """Plays up to so many steps; how many it were."""
        for step in range(steps):
            if self.rules.end:
                return step
            every = self._episode.states_every
            if every and step % every == 0:
                self._take_state(go_back=step % (2 * every) == 0)
            if not self.rules.end:
                self._step(next(self._actions))
        return steps

    def hashes(self) -> dict[str, str]:
        """Of all that has been seen so far."""
        return {
            "observed": self._observed.hexdigest()[:16],
            "rest": self._rest.hexdigest()[:16],
            "states": self._states.hexdigest()[:16],
        }

    def _step(self, action: int) -> None:
        reward, end = self.rules.step(action)
        self._events.counts["forced_actions"] += self.rules.action_was_forced
        self._observed.update(json.dumps([reward, end]).encode())
        if self._trace:
            self._trace({"reward": [reward], "end": [len(end)]})

    def _see(self, info: Any) -> None:
        self._engine_steps += 1
        numbers = observed_numbers(
            self._game, info, self.rules.sticky_actions, self.rules.scenario_rules.duration
        )
        others = other_numbers(info)
        if info.is_in_play:
            self._observed.update(_bytes(numbers))
            self._rest.update(_bytes(others))
        else:
            self._rest.update(_bytes({**numbers, **others}))
        # Once before the first kick-off, at step -1, the engine says that the game is in play.
        self._events.see(numbers, info.is_in_play and info.step >= 0)
        if self._trace:
            self._trace({**numbers, **others})

    def _take_state(self, go_back: bool) -> None:
        """Takes a state; if asked for, plays on, goes back to it and plays the same again."""
        state = self._game.get_state("")
        self._states.update(hide_uninitialised(state))
        if not go_back:
            return
        memory = self.rules.memory()
        actions = [next(self._actions) for _ in range(_REPLAYED_STEPS)]
        first = self._hash_of(actions)
        self._game.set_state(state)
        self.rules.remember(memory)
        self._replays.append(self._hash_of(actions) == first)

    def _hash_of(self, actions: list[int]) -> str:
        """Plays actions; the hash of what they led to, which counts for the episode's as well."""
        before, self._observed = self._observed, hashlib.sha256()
        for action in actions:
            if not self.rules.end:
                self._step(action)
        digest = self._observed.hexdigest()
        self._observed = before
        self._observed.update(digest.encode())
        return digest


def _bytes(numbers: Numbers) -> bytes:
    """The bits of numbers: the engine's are of single precision, which double precision holds."""
    return array("d", chain.from_iterable(numbers.values())).tobytes()


def lines_of_our_own() -> TextIO:
    """Standard output for this program alone: what the engine prints goes to standard error."""
    output = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return output


def _main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--trace", type=int, metavar="N")
    parser.add_argument("--steps", type=int, help="no more episodes after so many steps")
    arguments = parser.parse_args()
    output = lines_of_our_own()

    def write(line: dict[str, Any]) -> None:
        output.write(json.dumps(line) + "\n")
        output.flush()

    loaded = load_engine()
    write({"engine": loaded.file})
    game = loaded.start()
    steps = 0
    for index, line in enumerate(sys.stdin):
        traced = write if index == arguments.trace else None
        record = RecordedEpisode(loaded, game, Episode(**json.loads(line)), traced).play()
        write(record)
        steps += record["steps"]
        if arguments.steps and steps >= arguments.steps:
            break
    write({"done": steps})


if __name__ == "__main__":
    _main()
