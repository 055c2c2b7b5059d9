"""The passes that densities are fitted to, and how they are taken out of a match's events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fbrl.checks import check_field_types
from fbrl.density.coordinates import STATSBOMB_LENGTH, STATSBOMB_WIDTH, pitch_from_statsbomb

POSITION_COLUMNS = ("x", "y", "end_x", "end_y")


@dataclass(frozen=True)
class Pass:
    """One pass on StatsBomb's 120 x 80 pitch, from x and y to end_x and end_y.

    The attack goes towards x = 120, and y grows downwards from the top.

    Attributes:
        match_id: StatsBomb's number of the match; ``None`` if unknown.
        group: competition and season, or the file it comes from: what counts are given per.
        play_pattern: how the possession began, such as "Regular Play".
        pass_type: such as "Corner" or "Recovery"; ``None`` for an ordinary pass.
        cross: whether it was a cross.
        goal_assist: whether the shot that it led to was a goal.
    """

    x: float
    y: float
    end_x: float
    end_y: float
    match_id: int | None = None
    group: str = ""
    play_pattern: str | None = None
    pass_type: str | None = None
    cross: bool = False
    goal_assist: bool = True

    @property
    def position(self) -> tuple[float, float, float, float]:
        """Start and end: x, y, end_x, end_y."""
        return self.x, self.y, self.end_x, self.end_y


EVENT_COLUMNS = frozenset({"play_pattern", "pass_type", "cross", "goal_assist"})
"""What filters may ask about, all of it known where passes come from events."""


@dataclass(frozen=True)
class Passes:
    """Passes of one source.

    Attributes:
        rows: the passes.
        known: which of :data:`EVENT_COLUMNS` the source tells; the others hold their defaults.
        origin: what messages call the source.
    """

    rows: Sequence[Pass]
    known: frozenset[str]
    origin: str


def passes_of_match(events: Iterable[Mapping[str, Any]], match_id: int) -> list[Pass]:
    """The passes of a match that led to a shot, goals included.

    Raises:
        ValueError: if the events are not in StatsBomb's layout.
    """
    try:
        return [
            _pass_of_event(event, match_id)
            for event in events
            if event["type"]["name"] == "Pass"
            and (event["pass"].get("goal_assist") or event["pass"].get("shot_assist"))
        ]
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"Match {match_id}: an event is not in StatsBomb's layout "
            f"({type(error).__name__}: {error})."
        ) from error


def _pass_of_event(event: Mapping[str, Any], match_id: int) -> Pass:
    details = event["pass"]
    row = Pass(
        *_position(event.get("location")),
        *_position(details.get("end_location")),
        match_id=match_id,
        play_pattern=event["play_pattern"]["name"],
        pass_type=details["type"]["name"] if "type" in details else None,
        cross=bool(details.get("cross", False)),
        goal_assist=bool(details.get("goal_assist", False)),
    )
    check_field_types(row)
    return row


def _position(location: Sequence[Any] | None) -> tuple[float, float]:
    """NaN where an event lacks it, which :func:`clean` leaves out or refuses."""
    if not location:
        return math.nan, math.nan
    x, y = (float(value) for value in location[:2])
    return x, y


class Cleaned(NamedTuple):
    """The passes that :func:`clean` has kept, and how many it left out as repeated or unusable."""

    rows: list[Pass]
    repeated: int
    unusable: int


def clean(passes: Passes, *, drop_unusable: bool = False) -> Cleaned:
    """Leaves out passes that are listed twice and, if asked, those at impossible positions.

    Two passes of one match with the same start and end are one pass. Without the match that can't
    be told, and equal rows are all kept. Unusable are positions that are NaN, infinite or outside
    the pitch.

    Raises:
        ValueError: for the first of these, if they are not dropped.
    """
    rows: list[Pass] = []
    seen: set[tuple[int, tuple[float, ...]]] = set()
    repeated = unusable = 0
    for number, row in enumerate(passes.rows, start=1):
        if not _on_pitch(row):
            if not drop_unusable:
                match = "" if row.match_id is None else f" (match {row.match_id})"
                raise ValueError(
                    f"{passes.origin}: pass {number}{match} goes from "
                    f"({row.x:g}, {row.y:g}) to ({row.end_x:g}, {row.end_y:g}), which is not on "
                    "the pitch [0, 120] x [0, 80]. Correct it, or leave such passes out: "
                    "drop_unusable=True, --drop-unusable on a command line."
                )
            unusable += 1
            continue
        if row.match_id is not None:
            key = (row.match_id, row.position)
            if key in seen:
                repeated += 1
                continue
            seen.add(key)
        rows.append(row)
    return Cleaned(rows, repeated, unusable)


def _on_pitch(row: Pass) -> bool:
    # Comparisons with NaN are false.
    return all(0 <= x <= STATSBOMB_LENGTH for x in (row.x, row.end_x)) and all(
        0 <= y <= STATSBOMB_WIDTH for y in (row.y, row.end_y)
    )


def in_group(rows: Iterable[Pass], group: str) -> list[Pass]:
    """The same passes, counted under a group."""
    return [replace(row, group=group) for row in rows]


def starts_and_ends(rows: Sequence[Pass]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Start and end positions in the environment's pitch units, each (n, 2)."""
    table = np.array([row.position for row in rows], dtype=np.float64).reshape(-1, 4)
    return pitch_from_statsbomb(table[:, :2]), pitch_from_statsbomb(table[:, 2:])
