"""A process that plays matches for another one, from both sides."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from fbrl.envs.vector_env import ActionSet, FootballVectorEnv

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
"""What terminals and schedulers send to a whole group of processes, to have it end in order."""


class WorkerLostError(Exception):
    """A worker has died or does not answer; says why."""


class CallFailedError(Exception):
    """A call has raised the exception that is this one's cause; the worker goes on."""


@dataclass(frozen=True)
class WorkerSettings:
    """What a worker plays.

    Attributes:
        scenario, num_envs, num_threads, observation_keys, action_set: Of its
            :class:`FootballVectorEnv`.
        first_match: Number of its first match among those of all workers.
        seeds: A seed for each match, with which the first episodes begin.
    """

    scenario: str
    num_envs: int
    num_threads: int
    observation_keys: tuple[str, ...]
    action_set: ActionSet
    first_match: int
    seeds: Sequence[int | None]


class MatchWorker:
    """The process as the other one sees it; it starts at once.

    It ends with the other process, or when it is told to, but by none of :data:`ENDING_SIGNALS`:
    what these mean is for the other process to decide.

    Args:
        name: Of the process.
        settings: What it plays. Its first answer is what the matches begin with.

    Attributes:
        process: The worker itself.
    """

    def __init__(self, name: str, settings: WorkerSettings) -> None:
        self._connection, theirs = multiprocessing.Pipe()
        self.process = multiprocessing.get_context("spawn").Process(
            target=_play_matches_for, args=(theirs, settings), name=name, daemon=True
        )
        with _blocked_signals():
            # Python's own helper of such processes, which outlives these signals in the same way.
            # Its start unblocks some of them.
            resource_tracker.ensure_running()
        with _blocked_signals():
            # A process is blocked like the one that starts it, until it can ignore them.
            self.process.start()
        theirs.close()
        # Before multiprocessing's own end, which waits for what SIGTERM has no effect on.
        atexit.register(self.end)

    def ask(self, method: str, arguments: dict[str, Any]) -> None:
        """Has a method of its :class:`FootballVectorEnv` called, or a property read."""
        # One that has died is noticed when it does not answer.
        with contextlib.suppress(OSError):
            self._connection.send((method, arguments))

    def answer(self, timeout: float) -> Any:
        """What the method returned.

        Args:
            timeout: Seconds to wait; 0 for ever.

        Raises:
            CallFailedError: It raised an exception.
            WorkerLostError: It has died, or does not answer in time.
        """
        waited = 0.0
        while not wait([self._connection, self.process.sentinel], 1.0):
            # Counted, not measured: a process that stands still does not wait.
            waited += 1
            if timeout and waited >= timeout:
                raise WorkerLostError(f"has not answered for {waited:g} s")
        try:
            went_well, answer = self._connection.recv()
        except (EOFError, OSError) as error:
            raise WorkerLostError(self._how_it_died()) from error
        if not went_well:
            raise CallFailedError from answer
        return answer

    def end(self) -> None:
        """Ends the process, whatever it is doing."""
        atexit.unregister(self.end)
        self.process.kill()
        self.process.join()
        self._connection.close()

    def _how_it_died(self) -> str:
        self.process.join(1)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"was ended by {signal.Signals(-code).name}"
        return f"ended with exit code {code}"


@contextlib.contextmanager
def _blocked_signals() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _play_matches_for(connection: Connection, settings: WorkerSettings) -> None:
    """Answers ``(method, arguments)`` with ``(whether it went well, result or exception)``.

    It ends with the connection, as when the process at its other end has died.
    """
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    matches = FootballVectorEnv(
        settings.scenario,
        settings.num_envs,
        settings.num_threads,
        settings.observation_keys,
        settings.action_set,
    )
    matches.first_match = settings.first_match
    first = matches.reset(seed=settings.seeds)
    with contextlib.suppress(EOFError, OSError):
        connection.send((True, first))
        while True:
            method, arguments = connection.recv()
            connection.send(_call(matches, method, arguments))


def _call(matches: FootballVectorEnv, method: str, arguments: dict[str, Any]) -> tuple[bool, Any]:
    try:
        if method == "episodes":
            return True, matches.episodes
        return True, getattr(matches, method)(**arguments)
    except Exception as error:
        return False, error
