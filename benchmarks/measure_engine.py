"""The limit: engines that step on all cores, with nothing of Python beyond the calls."""

from __future__ import annotations

import importlib
import itertools
import os
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.rounds import Contestant, run_worker
from fbrl.envs.engine import FIRST_EPISODE, NUM_ACTIONS, build_scenario, load_gfootball
from fbrl.envs.matches import Matches


@dataclass
class _Played:
    """What a thread did, and the seconds that it took."""

    steps: int = 0
    resets: int = 0
    step_seconds: float = 0.0
    reset_seconds: float = 0.0


def bare_engine(scenario: str, seconds: float, seed: int) -> dict[str, float]:
    """Steps an engine on each core through matches of a player who acts at random.

    Returns:
        ``steps_per_second`` of stepping alone, ``resets_per_second`` of resets alone, until the
        game is in play, and ``frames_per_second`` of both as they come; all over all cores.
    """
    threads = len(os.sched_getaffinity(0))
    function = "benchmarks.measure_engine:record_episodes"
    wanted = {"scenario": scenario, "seconds": seconds}
    episodes = run_worker(Contestant(scenario, "recorder", function, wanted), seed)["episodes"]
    engines = [start_engine() for _ in range(threads)]

    def play(index: int) -> _Played:
        # Each thread begins elsewhere in the list.
        first = index * len(episodes) // threads
        mine = itertools.islice(itertools.cycle(episodes), first, None)
        return _replay(engines[index], scenario, mine, seconds)

    with ThreadPoolExecutor(threads) as pool:
        played = list(pool.map(play, range(threads)))
    return {
        "steps_per_second": sum(p.steps / p.step_seconds for p in played),
        "resets_per_second": sum(p.resets / p.reset_seconds for p in played),
        "frames_per_second": sum(p.steps / (p.step_seconds + p.reset_seconds) for p in played),
    }


def start_engine() -> Any:
    """An engine as gfootball's own environment uses it."""
    load_gfootball()
    gfootball_engine = importlib.import_module("gfootball_engine")
    engine = gfootball_engine.GameEnv()
    engine.start_game()
    engine.state = gfootball_engine.GameState.game_running
    return engine


def record_episodes(scenario: str, seconds: float, seed: int) -> dict[str, Any]:
    """Engine seed and length of matches of :func:`random_actions`, the last one cut short.

    The native matches know when one ends; they are played in a process of their own, since the
    default build's classes of a scenario are others.
    """
    random = np.random.default_rng(seed)
    match = Matches(scenario, 1, 1, [])
    episodes = []
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        engine_seed = int(random.integers(2**31))
        match.prepare(0, engine_seed, FIRST_EPISODE)
        match.begin([0])
        length = 0
        for action in random_actions(engine_seed):
            match.step([0], [action])
            length += 1
            if match.not_running() or time.perf_counter() > deadline:
                break
        episodes.append((engine_seed, length))
    match.close()
    return {"episodes": episodes}


def random_actions(seed: int) -> list[int]:
    """Actions of a match, more than it can last."""
    return np.random.default_rng(seed).integers(NUM_ACTIONS, size=3100).tolist()


def _replay(
    engine: Any, scenario: str, episodes: Iterable[tuple[int, int]], seconds: float
) -> _Played:
    action_set = load_gfootball().action_set.action_set_v1
    backend_actions = [action._backend_action for action in action_set]
    played = _Played()
    deadline = time.perf_counter() + seconds
    for engine_seed, length in episodes:
        if time.perf_counter() > deadline:
            break
        config = build_scenario(scenario, engine_seed, FIRST_EPISODE)
        actions = [backend_actions[a] for a in random_actions(engine_seed)[:length]]
        started = time.perf_counter()
        engine.reset(config, False)
        while not engine.get_info().is_in_play:
            engine.step()
        reset = time.perf_counter()
        for action in actions:
            engine.perform_action(action, True, 0)
            engine.step()
            # As a match does it: where the game has stopped, on to where it is in play again.
            while not engine.get_info().is_in_play:
                engine.step()
        played.step_seconds += time.perf_counter() - reset
        played.reset_seconds += reset - started
        played.steps += length
        played.resets += 1
    return played
