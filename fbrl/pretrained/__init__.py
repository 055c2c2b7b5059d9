"""Trained agents to start from: ``pretrained:NAME`` in the place of a run or a checkpoint.

Each is a checkpoint without what only its training needs, and a card beside it, which says how it
was trained and how well it plays.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fbrl.checks import check_name

PREFIX = "pretrained:"

_FOLDER = Path(__file__).parent


def pretrained_names() -> tuple[str, ...]:
    """The agents that fbrl brings along.

    Each is named for the scenario that it was trained on, and those beside the one to begin with
    for their reward too.
    """
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.pt")))


def locate(path: Path | str) -> Path:
    """The file of ``pretrained:NAME``; any other path as it is.

    Raises:
        UnknownNameError: There is no such agent.
    """
    text = str(path)
    if not text.startswith(PREFIX):
        return Path(path)
    name = check_name("pretrained agent", text.removeprefix(PREFIX), pretrained_names())
    return _FOLDER / f"{name}.pt"


def read_card(name: str) -> dict[str, Any]:
    """What is known of an agent.

    Returns:
        ``scenario`` and ``reward``; ``frames`` of all trainings that led to it, of which an agent's
        own ``frames`` are the last one's; ``commands`` that trained it; ``goal_difference``, the
        mean over ``episodes`` fresh matches, with ``low`` and ``high``, its 95 % interval;
        ``license`` and ``credit``.

    Raises:
        UnknownNameError: There is no such agent.
    """
    name = check_name("pretrained agent", name, pretrained_names())
    card: dict[str, Any] = json.loads((_FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return card
