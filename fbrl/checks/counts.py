"""Numbers of things, with an answer that helps where they are none."""

from __future__ import annotations

import numbers
from typing import Any


def check_count(name: str, count: Any, at_least: int = 1) -> int:
    """Returns the count as an ``int``; messages call it ``name``.

    Raises:
        TypeError: It is no integer; ``True`` is none either.
        ValueError: It is too small.
    """
    if isinstance(count, bool) or not isinstance(count, numbers.Integral):
        raise TypeError(f"{name} is {count!r}; it must be an integer of at least {at_least}.")
    if count < at_least:
        raise ValueError(f"{name} is {count}; it must be at least {at_least}.")
    return int(count)
