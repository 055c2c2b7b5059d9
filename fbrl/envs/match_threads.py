"""The threads that step and reset matches."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, TypeVar

Result = TypeVar("Result")


@dataclass(eq=False, slots=True)
class Call:
    """A call of a team that has not returned yet; equal to itself alone.

    Attributes:
        arguments: What the function was called with.
        describe: The team's, see :class:`MatchThreads`.
    """

    arguments: tuple[Any, ...]
    describe: Callable[[Any], str]

    def __str__(self) -> str:
        return self.describe(self.arguments[0])


_teams: weakref.WeakValueDictionary[int, MatchThreads] = weakref.WeakValueDictionary()


def calls_in_hand() -> list[Call]:
    """What the teams of this process are working on at this moment; may be asked by any thread."""
    teams = [reference() for reference in _teams.valuerefs()]
    return [call for team in teams if team is not None for call in team.in_hand.copy().values()]


class MatchThreads:
    """A team of threads to which the calling thread belongs.

    The engine releases the GIL while it computes, so that the threads are as parallel as processes.

    Args:
        num_threads: Size of the team, the calling thread included.
        describe: What the first argument of a call stands for, in words.

    Attributes:
        in_hand: The calls that have not returned yet, by their place among those of a :meth:`map`.
    """

    def __init__(self, num_threads: int, describe: Callable[[Any], str] = str) -> None:
        self.num_threads = num_threads
        self.in_hand: dict[int, Call] = {}
        self._describe = describe
        _teams[id(self)] = self
        self._pool = ThreadPoolExecutor(max(1, num_threads - 1), "match")

    def map(self, function: Callable[..., Result], *arguments: Iterable[Any]) -> list[Result]:
        """Calls the function as the built-in ``map`` does; returns when all calls have.

        Every thread takes the next call that is left, so that a long one delays no other.
        """
        calls = list(enumerate(zip(*arguments, strict=True)))
        results: list[Any] = [None] * len(calls)
        left = iter(calls)

        def work() -> None:
            for number, values in left:
                self.in_hand[number] = Call(values, self._describe)
                try:
                    results[number] = function(*values)
                finally:
                    del self.in_hand[number]

        # This thread takes part, instead of waiting for one more.
        others = [self._pool.submit(work) for _ in range(min(self.num_threads, len(calls)) - 1)]
        try:
            work()
        finally:
            # Whatever went wrong here, no match is left being stepped behind the caller's back.
            wait(others)
        for other in others:
            other.result()
        return results

    def close(self) -> None:
        """Ends the threads."""
        self._pool.shutdown()
