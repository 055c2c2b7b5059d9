"""Plays fixed episodes of one scenario with fbrl_engine.Matches, as play_matches.py does without.

    python engine/tests/play_native.py --threads 4 < EPISODES > RESULTS

Several matches are played at a time, each one's episodes one after another: an episode begins while
other matches still step. What a record holds is made of the arrays that the matches write to.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import asdict
from typing import Any

import numpy as np
from any_engine import AnyEngine, load_engine
from episodes import Episode
from observation import KEYS, Numbers, bits
from play_matches import episodes_of_lines, print_lines_alone

_MATCHES = 3


class NativeMatches:
    """Matches of one scenario, and the arrays that they write to.

    Args:
        loaded: The engine's modules.
        queues: For each match its episodes.
        threads: How many play them.
    """

    def __init__(self, loaded: AnyEngine, queues: list[list[Episode]], threads: int) -> None:
        import fbrl_engine  # pip's engine has none

        self._loaded = loaded
        self._queues = queues
        self._matches = fbrl_engine.Matches(queues[0][0].scenario, len(queues), threads)
        self._arrays: dict[str, Any] = {
            # What the matches don't write is no number that could be equal.
            name: np.full((len(queues), *shape), 99, dtype)
            for name, (shape, dtype) in fbrl_engine.FIELDS.items()
        }
        self._rows = fbrl_engine.Rows(self._arrays)
        self._next = [0] * len(queues)

    def play(self) -> list[dict[str, Any]]:
        """Plays all episodes; a record for each, those of the first match first."""
        records: list[list[dict[str, Any]]] = [[] for _ in self._queues]
        recorded: dict[int, _Recorded] = {}
        for match in range(len(self._queues)):
            self._prepare_next(match)
        beginning = list(range(len(self._queues)))
        while beginning or recorded:
            if beginning:
                self._matches.send_begin(beginning, self._rows).wait()
                for match in beginning:
                    episode = self._queues[match][self._next[match] - 1]
                    recorded[match] = _Recorded(episode, self._numbers(match))
                    # Before its end, so that it begins the next one by itself.
                    self._prepare_next(match)
            running = list(recorded)
            actions = [next(recorded[match].actions) for match in running]
            self._matches.send_step(running, actions, self._rows).wait()
            beginning = []
            for match in running:
                recorded[match].add(self._numbers(match), *self._results(match))
                if not self._matches.is_running(match):
                    records[match].append(recorded.pop(match).record())
                    beginning += [match] * (len(records[match]) < len(self._queues[match]))
        self._matches.close()
        return [record for queue in records for record in queue]

    def _prepare_next(self, match: int) -> None:
        if self._next[match] == len(self._queues[match]):
            return
        episode = self._queues[match][self._next[match]]
        config = self._loaded.scenario(episode)
        self._matches.prepare(match, config, episode.seed, episode.number)
        self._next[match] += 1

    def _numbers(self, match: int) -> Numbers:
        """As the engine shows them, without the places of players that the scenario lacks."""
        numbers = {}
        for key in KEYS:
            values = self._arrays[key][match]
            if key.startswith(("left_team", "right_team")):
                roles = self._arrays[f"{key.split('_')[0]}_team_roles"][match]
                values = values[: np.count_nonzero(roles != -1)]
            numbers[key] = [float(value) for value in np.ravel(values)]
        return numbers

    def _results(self, match: int) -> tuple[int, bool, bool]:
        names = ("reward", "terminated", "truncated")
        reward, terminated, truncated = (self._arrays[name][match] for name in names)
        return int(reward), bool(terminated), bool(truncated)


class _Recorded:
    def __init__(self, episode: Episode, numbers: Numbers) -> None:
        self.actions = episode.actions()
        self._episode = episode
        self._observed = hashlib.sha256(bits(numbers))
        self._steps = 0
        self._end = ""

    def add(self, numbers: Numbers, reward: int, terminated: bool, truncated: bool) -> None:
        self._steps += 1
        if truncated:
            self._end = "time_limit"
        elif terminated:
            out = "out_of_play" if numbers["game_mode"][0] else "possession"
            self._end = "score" if sum(numbers["score"]) else out
        self._observed.update(bits(numbers))
        self._observed.update(json.dumps([reward, self._end]).encode())

    def record(self) -> dict[str, Any]:
        return {
            **asdict(self._episode),
            "steps": self._steps,
            "observed": self._observed.hexdigest()[:16],
            "end": self._end,
        }


def _main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    write = print_lines_alone()
    loaded = load_engine()
    write({"engine": loaded.file})
    episodes = list(episodes_of_lines(sys.stdin))
    queues = [episodes[match::_MATCHES] for match in range(_MATCHES)]
    records = NativeMatches(loaded, queues, arguments.threads).play()
    for record in records:
        write(record)
    write({"done": sum(record["steps"] for record in records)})


if __name__ == "__main__":
    _main()
