"""Saves states of episodes, or goes on from saved ones, on the engine that Python finds first.

    PYTHONPATH=DIRECTORY python engine/tests/cross_states.py {save,restore} FOLDER < EPISODES

`save` plays each episode up to its limit, writes the state into FOLDER, and plays 200 steps more.
`restore` begins the episode, takes the state, and plays the same 200 steps. Both print a JSON line
for each episode, with a hash of all that was to be seen in those steps.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from any_engine import load_engine
from episodes import Episode
from match_rules import Memory
from play_matches import episodes_of_lines, print_lines_alone
from recorded_episode import RecordedEpisode

_STEPS_AFTER = 200


def _save(recorded: RecordedEpisode, game: Any, episode: Episode, path: Path) -> None:
    recorded.begin()
    recorded.go_on(episode.limit - _STEPS_AFTER)
    if recorded.rules.end:
        raise ValueError(f"The episode has ended before its state was to be saved: {episode}")
    path.with_suffix(".state").write_bytes(game.get_state(""))
    path.with_suffix(".json").write_text(json.dumps(recorded.rules.memory()))


def _restore(recorded: RecordedEpisode, game: Any, episode: Episode, path: Path) -> None:
    # Which team is processed first, and who kicks off, is no part of the engine's state.
    recorded.begin()
    game.set_state(path.with_suffix(".state").read_bytes())
    recorded.rules.remember(Memory(*json.loads(path.with_suffix(".json").read_text())))
    recorded.skip_actions(episode.limit - _STEPS_AFTER)


def _main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("way", choices=("save", "restore"))
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    come_to_state = _save if arguments.way == "save" else _restore
    write = print_lines_alone()
    game = (loaded := load_engine()).start()
    write({"engine": loaded.file})
    for index, saved in enumerate(episodes_of_lines(sys.stdin)):
        episode = replace(saved, limit=saved.limit + _STEPS_AFTER)
        recorded = RecordedEpisode(loaded, game, episode)
        come_to_state(recorded, game, episode, arguments.folder / f"{index:03}")
        recorded.steps = saved.limit
        recorded.forget_hashes()
        recorded.go_on(_STEPS_AFTER)
        steps = recorded.steps - saved.limit
        write(
            {
                "episode": index,
                "steps": steps,
                "end": recorded.rules.end,
                **recorded.hashes(),
            }
        )
    write({"done": True})


if __name__ == "__main__":
    _main()
