"""A process that plays matches for another one."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from fbrl.envs.vector_env import ActionSet, FootballVectorEnv


@dataclass(frozen=True)
class WorkerSettings:
    """What a worker plays.

    Attributes:
        scenario, num_envs, num_threads, observation_keys, action_set: Of its
            :class:`FootballVectorEnv`.
        seeds: A seed for each match, with which the first episodes begin.
    """

    scenario: str
    num_envs: int
    num_threads: int
    observation_keys: tuple[str, ...]
    action_set: ActionSet
    seeds: Sequence[int | None]


def play_matches_for(connection: Connection, settings: WorkerSettings) -> None:
    """Answers ``(method, arguments)`` with ``(whether it went well, result or exception)``.

    The first answer is what the matches begin with. It ends with the connection, as when the
    process at its other end has died.
    """
    # The process at the other end decides what an interrupt means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    matches = FootballVectorEnv(
        settings.scenario,
        settings.num_envs,
        settings.num_threads,
        settings.observation_keys,
        settings.action_set,
    )
    connection.send((True, matches.reset(seed=settings.seeds)))
    while True:
        try:
            method, arguments = connection.recv()
        except EOFError:
            return
        connection.send(_answer(matches, method, arguments))


def _answer(matches: FootballVectorEnv, method: str, arguments: dict[str, Any]) -> tuple[bool, Any]:
    try:
        if method == "episodes":
            return True, matches.episodes
        return True, getattr(matches, method)(**arguments)
    except Exception as error:
        return False, error
