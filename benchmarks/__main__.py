"""``python -m benchmarks``: measures, and writes tables and a picture."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.builds import REPOSITORY
from benchmarks.figure import save_figure
from benchmarks.machine import describe_machine, load_warning
from benchmarks.results import SectionResults, load_results, save_results
from benchmarks.rounds import WorkerError, run_rounds
from benchmarks.sections import FULL, MEASURED_ONCE, QUICK, SECTIONS, Scale
from benchmarks.tables import write_page

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
    machine = describe_machine()
    if warning := load_warning():
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


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
