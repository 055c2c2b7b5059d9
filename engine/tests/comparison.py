"""What two engines have seen, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from engine_process import play
from events import EVENTS
from million import Shard

COMPARED = ("steps", "engine_steps", "observed", "rest", "states", "end", "replays", "events")
"""What of the records of two engines has to be equal."""

Records = list[dict[str, Any]]


class Difference(NamedTuple):
    """An episode of which two engines have seen different things.

    Attributes:
        shard: The episode's.
        episode: Which one of the shard, from 0.
        keys: What differs, of :data:`COMPARED`.
    """

    shard: Shard
    episode: int
    keys: list[str]

    def __str__(self) -> str:
        return f"{self.shard.name}, episode {self.episode}: {', '.join(self.keys)}"


def differing_keys(record: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """What differs of two records; all of it where one is missing, and so empty."""
    return [key for key in COMPARED if record.get(key) != other.get(key)]


class Table:
    """Sums of what was played, a row for each scenario, and what differed."""

    def __init__(self) -> None:
        self.differences: list[Difference] = []
        self._rows: dict[str, Counter[str]] = {}

    def add(self, shard: Shard, reference: Records, engine: Records) -> None:
        """Compares what both sides have of a shard."""
        row = self._rows.setdefault(shard.scenario, Counter())
        nothing: dict[str, Any] = {}
        pairs = zip_longest(reference, engine, fillvalue=nothing)
        for index, (record, other) in enumerate(pairs):
            keys = differing_keys(record, other)
            if keys:
                self.differences.append(Difference(shard, index, keys))
            row.update(episodes=1, differing=int(bool(keys)), steps=record.get("steps", 0))
            row.update(record.get("events", {}))

    def lines(self) -> Iterable[str]:
        """The table in Markdown."""
        columns = ("steps", "episodes", "differing", *EVENTS)
        names = " | ".join(column.replace("_", " ") for column in columns)
        yield f"| scenario | {names} |"
        yield "|---" * (len(columns) + 1) + "|"
        together: Counter[str] = Counter()
        for row in self._rows.values():
            together.update(row)
        for name, row in [*sorted(self._rows.items()), ("together", together)]:
            yield f"| {name} | {' | '.join(str(row[column]) for column in columns)} |"


def first_differing_step(
    difference: Difference, reference: Path | None, engine: Path | None
) -> str:
    """Plays a shard again on both engines, up to an episode; says where that begins to differ."""
    options = ("--trace", str(difference.episode), "--episodes", str(difference.episode + 1))
    sides = [play(side, difference.shard.episodes(), *options) for side in (reference, engine)]
    step = 0
    for numbers, others in zip(*sides, strict=False):
        if "engine" in numbers or "scenario" in numbers:
            continue
        keys = [key for key in numbers if numbers[key] != others.get(key)]
        if keys:
            values = f"pip's engine has {numbers[keys[0]]}, ours {others.get(keys[0])}"
            return f"step {step}: {', '.join(keys)}; of {keys[0]} {values}"
        step += "reward" in numbers
    return "no step: played again, the episode is equal"
