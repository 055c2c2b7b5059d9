"""Where the two engines are that the tests compare, and what pip's has played."""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ci_episodes import episodes
from comparison import COMPARED, differing_keys
from engine_process import play
from episodes import Episode
from libm import fingerprint

RECORDED = Path(__file__).with_name("reference.json")
# What a processor without fused multiplication and addition computes, on any processor.
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4"}
_PROCESSES = 2


def engine_directory() -> Path | None:
    """Where our packages are, from FBRL_ENGINE; None for the installed ones."""
    directory = os.environ.get("FBRL_ENGINE")
    return Path(directory) if directory else None


def reference_directory() -> Path | None:
    """Where gfootball is as pip builds it, from FBRL_REFERENCE_ENGINE or in its usual place."""
    directory = os.environ.get("FBRL_REFERENCE_ENGINE")
    if directory:
        return Path(directory)
    usual = Path(__file__).parents[2] / "build" / "default-engine"
    return usual if usual.exists() else None


def play_in_processes(
    engine: Path | None,
    wanted: Sequence[Episode],
    environment: dict[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Plays every other episode in one process, and the rest in another."""

    def play_part(part: Sequence[Episode]) -> list[dict[str, Any]]:
        lines = play(engine, part, environment=environment)
        return [line for line in lines if "scenario" in line]

    records: list[dict[str, Any]] = [{}] * len(wanted)
    with ThreadPoolExecutor(_PROCESSES) as pool:
        parts = pool.map(play_part, [wanted[place::_PROCESSES] for place in range(_PROCESSES)])
        for place, part in enumerate(parts):
            records[place::_PROCESSES] = part
    return records


def compared(record: dict[str, Any]) -> dict[str, Any]:
    """What of a record has to be equal, and shows in a message where it is not."""
    return {key: record[key] for key in COMPARED}


def differences(
    wanted: Iterable[Episode],
    records: Iterable[dict[str, Any]],
    others: Iterable[dict[str, Any]],
) -> list[str]:
    """A line for each episode of which two engines have seen different things."""
    return [
        f"{episode}: {', '.join(keys)}"
        for episode, record, other in zip(wanted, records, others, strict=True)
        if (keys := differing_keys(record, other))
    ]


def digest_of_plan() -> str:
    """Changes where the episodes do: what was recorded of others proves nothing."""
    return hashlib.sha256(repr(episodes()).encode()).hexdigest()[:16]


def recorded(libm: str) -> list[dict[str, Any]] | None:
    """What pip's engine played of the tests' episodes on such a machine; None if nobody knows."""
    content = json.loads(RECORDED.read_text())
    if content["plan"] != digest_of_plan():
        raise ValueError(f"{RECORDED.name} is of other episodes: run record_reference.py anew.")
    for recording in content["recordings"]:
        if libm in recording["libm"]:
            records: list[dict[str, Any]] = recording["records"]
            return records
    return None


def write_recordings(recordings: Iterable[tuple[list[str], list[dict[str, Any]]]]) -> None:
    """Writes what :func:`recorded` reads: the machines of each recording, and its records."""
    lines = ",\n".join(
        f'{{"libm": {json.dumps(machines)}, "records": [\n'
        + ",\n".join(json.dumps(record) for record in records)
        + "\n]}"
        for machines, records in recordings
    )
    RECORDED.write_text(f'{{"plan": "{digest_of_plan()}", "recordings": [\n{lines}\n]}}\n')


@functools.cache
def reference_records() -> list[dict[str, Any]]:
    """What pip's engine plays of the tests' episodes on this machine.

    Where its sines are those of the machine on which this was recorded, so are its matches, and the
    record serves; 60 seconds are saved, and the 200 that pip's engine takes to build. Elsewhere,
    or where FBRL_REFERENCE_ENGINE asks for it, the engine plays them now.
    """
    records = None if "FBRL_REFERENCE_ENGINE" in os.environ else recorded(fingerprint())
    if records is not None:
        return records
    engine = reference_directory()
    if engine is None:
        raise FileNotFoundError(
            "This machine's mathematical functions are not those of a machine on which the matches "
            f"of pip's engine were recorded (libm {fingerprint()}). Build that engine, which takes "
            "4 minutes: `scripts/setup.sh --default-engine`."
        )
    return [compared(record) for record in play_in_processes(engine, episodes())]
