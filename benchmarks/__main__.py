"""``python -m benchmarks``: measures, and writes tables and a picture."""

from __future__ import annotations

import argparse
import dataclasses
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path

from benchmarks.figure import save_figure
from benchmarks.results import SectionResults, load_results, save_results
from benchmarks.rounds import REPOSITORY, WorkerError, run_rounds
from benchmarks.sections import FULL, MEASURED_ONCE, QUICK, SECTIONS, Scale
from benchmarks.tables import write_page
from fbrl.allocator import reason_against_tcmalloc
from fbrl.checks import memory_limit

_PACKAGES = (
    *("fbrl", "fbrl-engine", "torch", "torchrl", "tensordict", "gymnasium", "numpy"),
    "stable-baselines3",
)

BUSY = 0.5
"""Load per core from which on a machine counts as busy."""

EXAMPLES = """examples:
  python -m benchmarks                        # everything; about 25 minutes on two idle cores
  python -m benchmarks engine environment     # some sections; the others' tables stay
  python -m benchmarks training --repeats 5
  python -m benchmarks --quick                # does everything work? the figures mean nothing
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; exit code 1 if a measurement fails, 130 if it is interrupted."""
    options = _parse(arguments)
    scale = dataclasses.replace(QUICK if options.quick else FULL, device=options.device)
    output = options.output or (REPOSITORY / ("build/benchmarks" if options.quick else "docs"))
    machine = _describe_machine()
    if warning := _load_warning():
        _say(f"warning: {warning}")
    started = time.perf_counter()
    results = load_results(output / "performance.json")
    try:
        for section in options.sections:
            results[section] = _measure(section, scale, options.repeats, machine)
            ordered = {name: results[name] for name in SECTIONS if name in results}
            # After every section, so that an interruption loses one section at most.
            save_results(ordered, output / "performance.json")
            write_page(ordered, output / "performance.md")
            save_figure(ordered, output / "img" / "performance.png")
    except WorkerError as error:
        _say(f"error: {error}")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
    _say(f"done in {time.perf_counter() - started:.0f} s: {output / 'performance.md'}")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure fbrl and its peers in turn; write docs/performance.md.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "sections", nargs="*", metavar="SECTION", help=f"{', '.join(SECTIONS)}; default: all"
    )
    parser.add_argument("--repeats", type=int, default=3, help="rounds (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="tiny measurements, one round")
    parser.add_argument("--device", default="auto", help="of the networks: auto, cpu, cuda")
    parser.add_argument("--output", type=Path, help="directory (default: docs; build/benchmarks)")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"there is no section {unknown[0]!r}; there are {', '.join(SECTIONS)}")
    if options.repeats < 1:
        parser.error(f"--repeats is {options.repeats}; at least 1 round is needed")
    options.sections = options.sections or list(SECTIONS)
    if options.quick:
        options.repeats = 1
    return options


def _measure(
    section: str, scale: Scale, repeats: int, machine: dict[str, str | float]
) -> SectionResults:
    contestants = SECTIONS[section](scale)
    there = [contestant for contestant in contestants if contestant.build.is_there]
    if len(there) < len(contestants):
        _say(
            f"warning: {section}: leaving out the peers on gfootball's default build, which is "
            "not there; make it with: scripts/setup.sh --default-engine"
        )
    rounds = 1 if section in MEASURED_ONCE else repeats
    _say(f"{section}: {rounds} round(s) of {len(there)} measurements")
    rows = list(run_rounds(there, rounds, lambda line: _say(f"  {line}")))
    return SectionResults(machine, rows)


def _describe_machine() -> dict[str, str | float]:
    """Processor, cores, memory, load, versions and the commit, by name."""
    import torch

    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    return {
        "date": datetime.now().strftime("%Y-%m-%d %H:%M"),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "memory in GiB": round(memory_limit() / 2**30, 1),
        "GPU": gpu,
        "load before the run": round(os.getloadavg()[0], 2),
        "tcmalloc": reason_against_tcmalloc(os.environ) or "yes",
        "Python": platform.python_version(),
        **{name: metadata.version(name) for name in _PACKAGES},
        "commit": _commit(),
    }


def _load_warning() -> str | None:
    """A sentence where other programs are likely to disturb the measurement."""
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    if load < BUSY * cores:
        return None
    return (
        f"The machine is busy: its load average is {load:.1f} on {cores} cores. Ratios of this "
        "run are worth little; end other programs and run it again."
    )


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    values: dict[str, str] = {}
    for line in cpuinfo.splitlines():
        name, _, value = line.partition(":")
        values.setdefault(name.strip(), value.strip())
    model = values.get("model name", platform.processor() or platform.machine())
    return f"{model} (family {values.get('cpu family', '?')}, model {values.get('model', '?')})"


def _commit() -> str:
    describe = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    process = subprocess.run(describe, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    return process.stdout.strip() or "unknown"


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
