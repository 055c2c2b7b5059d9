"""Refuses what the machine has no memory for, before it is killed for it."""

from __future__ import annotations

import os
from pathlib import Path

_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_memory(what: str, needed: int, remedy: str) -> None:
    """Checks that the bytes needed, by a low estimate, fit into the memory that there is.

    Raises:
        ValueError: They don't; the message begins with what needs them, and ends with the remedy.
    """
    present = memory_limit()
    if needed > present:
        raise ValueError(
            f"{what} would take {needed / 2**30:,.1f} GiB of memory, of {present / 2**30:,.1f} GiB "
            f"here. {remedy}"
        )


def memory_limit() -> int:
    """The machine's memory, or what a container or a job's limit leaves of it; bytes."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        return min(machine, int(_GROUP_LIMIT.read_text(encoding="utf-8")))
    except (OSError, ValueError):  # no limit
        return machine
