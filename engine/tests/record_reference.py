"""Records what pip's engine plays of the tests' episodes, into reference.json.

    python engine/tests/record_reference.py

To be run where the episodes have changed. It plays as a processor with fused multiplication and
addition computes, if this is one, and as one without it does.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from ci_episodes import episodes
from engines import (
    WITHOUT_FMA,
    compared,
    play_in_processes,
    reference_directory,
    write_recordings,
)


def _fingerprint(environment: dict[str, str]) -> str:
    program = "import libm; print(libm.fingerprint())"
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parent,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()


def _main() -> None:
    engine = reference_directory()
    if engine is None:
        sys.exit("There is no engine as pip builds it: run `scripts/setup.sh --default-engine`.")
    recordings: list[tuple[list[str], list[dict[str, Any]]]] = []
    for environment in ({}, WITHOUT_FMA):
        libm = _fingerprint(environment)
        played = play_in_processes(engine, episodes(), environment)
        records = [compared(record) for record in played]
        for machines, others in recordings:
            if records == others:
                machines.append(libm)
                break
        else:
            recordings.append(([libm], records))
    write_recordings(recordings)


if __name__ == "__main__":
    _main()
