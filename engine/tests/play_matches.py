"""Plays fixed episodes on whichever engine Python finds first, and prints a JSON line for each.

    PYTHONPATH=DIRECTORY python engine/tests/play_matches.py < EPISODES > RESULTS

Each line of EPISODES is an :class:`~episodes.Episode` in JSON. They are played one after another
on one engine, by gfootball's rules. The first line of RESULTS says which engine it was; each other
one has the hashes of all that was to be seen of an episode, its events, and how it ended. The last
line says that it is the last.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any

from any_engine import AnyEngine, load_engine
from episodes import Episode
from libm import fingerprint
from recorded_episode import RecordedEpisode

# Few, so that a match goes from thread to thread often.
_STEPS_OF_A_THREAD = 5


def print_lines_alone() -> Callable[[dict[str, Any]], None]:
    """Standard output for this program alone: what the engine prints goes to standard error.

    Returns:
        What writes a line.
    """
    output = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def write(line: dict[str, Any]) -> None:
        output.write(json.dumps(line) + "\n")
        output.flush()

    return write


def episodes_of_lines(lines: Iterable[str]) -> Iterator[Episode]:
    """The episodes that somebody has asked for."""
    for line in lines:
        yield Episode(**json.loads(line))


def _play_in_threads(
    loaded: AnyEngine, episodes: Iterator[Episode], threads: int
) -> Iterator[dict[str, Any]]:
    """Plays one match more at a time than there are threads, each in turns by any of them."""
    games = [loaded.start() for _ in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        # zip() takes from the games first, so that it leaves no episode out at their end.
        while group := [
            RecordedEpisode(loaded, game, episode)
            for game, episode in zip(games, episodes, strict=False)
        ]:
            list(pool.map(RecordedEpisode.begin, group))
            while playing := [episode for episode in group if not episode.is_over()]:
                list(pool.map(lambda episode: episode.go_on(_STEPS_OF_A_THREAD), playing))
            yield from (episode.record() for episode in group)


def _main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, help="no more episodes after so many steps")
    parser.add_argument("--episodes", type=int, help="no more episodes than so many")
    parser.add_argument("--threads", type=int, help="play on several engines in so many threads")
    parser.add_argument("--trace", type=int, help="print the numbers of an episode, from 0, too")
    arguments = parser.parse_args()
    write = print_lines_alone()
    loaded = load_engine()
    write({"engine": loaded.file, "libm": fingerprint()})
    steps = 0
    episodes = islice(episodes_of_lines(sys.stdin), arguments.episodes)
    if arguments.threads:
        for record in _play_in_threads(loaded, episodes, arguments.threads):
            write(record)
            steps += record["steps"]
    else:
        game = loaded.start()
        for index, episode in enumerate(episodes):
            trace = write if index == arguments.trace else None
            record = RecordedEpisode(loaded, game, episode, trace).play()
            write(record)
            steps += record["steps"]
            if arguments.steps and steps >= arguments.steps:
                break
    write({"done": steps})


if __name__ == "__main__":
    _main()
