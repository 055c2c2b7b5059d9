"""One episode, played on either engine and hashed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

from any_engine import AnyEngine
from episodes import Episode
from events import EventCounter
from foul import AFTER_STEPS, with_foul
from match_rules import MatchRules
from observation import Numbers, bits, observed_numbers, other_numbers
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
        self.steps = 0
        self._game = game
        self._episode = episode
        self._trace = trace
        self._actions = episode.actions()
        self._observed, self._rest, self._states = (hashlib.sha256() for _ in range(3))
        self._events = EventCounter(lambda: foul_type(game.get_state("")) == 0)
        self._engine_steps = 0
        self._replays: list[bool] = []

    def play(self) -> dict[str, Any]:
        """Plays the episode from its first to its last step."""
        self.begin()
        self.go_on(self._episode.limit)
        return self.record()

    def begin(self) -> None:
        """Plays up to the first action."""
        self.rules.reset(self._episode)

    def go_on(self, steps: int) -> None:
        """Plays so many steps more, or fewer where the episode ends or is left."""
        for _ in range(steps):
            if self.is_over():
                return
            if self._episode.foul and self.steps == AFTER_STEPS:
                self._game.set_state(with_foul(self._game.get_state(""), self._episode.foul))
            every = self._episode.states_every
            if every and self.steps % every == 0:
                self._take_state(go_back=self.steps % (2 * every) == 0)
            self._step(self._actions)
            self.steps += 1

    def is_over(self) -> bool:
        """Whether the episode has ended, or is left here."""
        return bool(self.rules.end) or self.steps >= self._episode.limit

    def skip_actions(self, steps: int) -> None:
        """Leaves out the actions of the first steps, which another process has played."""
        for _ in range(steps * len(self.rules.agents)):
            next(self._actions)

    def forget_hashes(self) -> None:
        """Begins the hashes anew."""
        self._observed, self._rest, self._states = (hashlib.sha256() for _ in range(3))

    def hashes(self) -> dict[str, str]:
        """Of the observations and rewards, of all else that was to be seen, and of the states."""
        return {
            "observed": self._observed.hexdigest()[:16],
            "rest": self._rest.hexdigest()[:16],
            "states": self._states.hexdigest()[:16],
        }

    def record(self) -> dict[str, Any]:
        """What was played, the hashes, and what happened."""
        return {
            **asdict(self._episode),
            "steps": self.steps,
            "engine_steps": self._engine_steps,
            **self.hashes(),
            "end": self.rules.end or "left",
            "events": {name: count for name, count in self._events.counts.items() if count},
            "replays": [len(self._replays), sum(self._replays)],
        }

    def _step(self, actions: Iterator[int]) -> None:
        reward, end = self.rules.step(actions)
        self._events.counts["forced_actions"] += self.rules.action_was_forced
        self._observed.update(json.dumps([reward, end]).encode())
        if self._trace:
            self._trace({"reward": [reward], "end": [len(end)]})

    def _see(self, info: Any) -> None:
        self._engine_steps += 1
        rules = self.rules
        numbers = observed_numbers(
            self._game, info, rules.sticky_actions, rules.scenario_rules.duration
        )
        others = other_numbers(self._game, info, rules.sticky_actions, rules.agents)
        if info.is_in_play:
            self._observed.update(bits(numbers))
            self._rest.update(bits(others))
        else:
            self._rest.update(bits({**numbers, **others}))
        # Once before the first kick-off, at step -1, the engine says that the game is in play.
        self._events.see(numbers, info.is_in_play and info.step >= 0)
        if self._trace:
            self._trace({**numbers, **others})

    def _take_state(self, go_back: bool) -> None:
        """Takes a state; if asked for, plays on, goes back to it, and plays the same again."""
        state = self._game.get_state("")
        self._states.update(hide_uninitialised(state))
        if not go_back:
            return
        memory = self.rules.memory()
        agents = len(self.rules.agents)
        actions = [next(self._actions) for _ in range(_REPLAYED_STEPS * agents)]
        first = self._hash_of(actions)
        self._game.set_state(state)
        self.rules.remember(memory)
        self._replays.append(self._hash_of(actions) == first)
        # Once more, so that the episode goes on from here, though the replay may have ended it.
        self._game.set_state(state)
        self.rules.remember(memory)

    def _hash_of(self, actions: list[int]) -> str:
        """Plays actions; the hash of what they led to, which counts for the episode's as well."""
        before, self._observed = self._observed, hashlib.sha256()
        played = iter(actions)
        for _ in range(_REPLAYED_STEPS):
            if not self.rules.end:
                self._step(played)
        digest = self._observed.hexdigest()
        self._observed = before
        self._observed.update(digest.encode())
        return digest
