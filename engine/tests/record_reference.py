"""Records what pip's engine plays of the tests' episodes, into reference.json.

    python engine/tests/record_reference.py

To be run where the episodes have changed. It plays as a processor with fused multiplication and
addition computes, if this is one, and as one without it does.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from ci_episodes import episodes
from engines import (
    RECORDED,
    WITHOUT_FMA,
    compared,
    digest_of_plan,
    play_in_processes,
    reference_directory,
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
    machines = {}
    for environment in ({}, WITHOUT_FMA):
        records = play_in_processes(engine, episodes(), environment)
        machines[_fingerprint(environment)] = [compared(record) for record in records]
    lines = ",\n".join(
        f'"{libm}": [\n' + ",\n".join(json.dumps(record) for record in records) + "\n]"
        for libm, records in machines.items()
    )
    RECORDED.write_text(f'{{"plan": "{digest_of_plan()}", "machines": {{\n{lines}\n}}}}\n')


if __name__ == "__main__":
    _main()
