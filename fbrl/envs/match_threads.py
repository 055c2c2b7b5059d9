"""The threads that step and reset matches."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

Result = TypeVar("Result")


class MatchThreads:
    """A team of threads to which the calling thread belongs.

    The engine releases the GIL while it computes, so that the threads are as parallel as processes.

    Args:
        num_threads: Size of the team, the calling thread included.
    """

    def __init__(self, num_threads: int) -> None:
        self.num_threads = num_threads
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
                results[number] = function(*values)

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
