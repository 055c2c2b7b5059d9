"""Choosing by name, with an answer that helps where the name is wrong."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UnknownNameError(ValueError):
    """Raised for a name that there is not, with the nearest and all names in its message."""


def check_name(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Returns the name if it is allowed; messages say what ``kind`` of name it is.

    Raises:
        UnknownNameError: The name is not among them.
    """
    names = list(allowed)
    if name in names:
        return name
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.3)
    hint = f" Did you mean {near[0]}?" if near else ""
    raise UnknownNameError(
        f"There is no {kind} {name!r:.100}.{hint} Choose from {', '.join(names)}."
    )
