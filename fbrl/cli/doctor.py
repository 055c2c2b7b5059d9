"""``fbrl-doctor``: says which part of an installation works, and what mends the others."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict

from rich.console import Console
from rich.markup import escape
from rich.table import Table

import fbrl
from fbrl.cli.errors import Parser, ending_when_interrupted
from fbrl.doctor import CHECKS, RENDERING, CheckResult, installation_works, run_checks

PROGRAM = "fbrl-doctor"

_DESCRIPTION = """\
Check each part of an fbrl installation: Python, the engine's system libraries, the engine, a
real match, torch and its device, TensorBoard, the densities and headless rendering."""

_EPILOG = """\
exit status: 0 if all that training needs works (rendering is not needed: only a warning),
1 if something needed fails, 2 for a wrong option."""

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the checks, prints what they found, and returns the exit status."""
    with ending_when_interrupted(PROGRAM):
        return _check(_parser().parse_args(arguments))


def _check(options: argparse.Namespace) -> int:
    checks = [check for check in CHECKS if options.render or check.name != RENDERING]
    with Console(stderr=True).status("Checking; rendering takes up to half a minute"):
        results = list(run_checks(checks))
    works = installation_works(results)
    if options.json:
        report = {
            "fbrl": fbrl.__version__,
            "ok": works,
            "checks": [asdict(result) for result in results],
        }
        print(json.dumps(report, indent=2))
    else:
        _print_table(results, works)
    return 0 if works else 1


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument(
        "--no-render",
        dest="render",
        action="store_false",
        help="leave out the check of headless rendering, which takes 10 to 30 seconds",
    )
    parser.add_argument("--version", action="version", version=f"fbrl {fbrl.__version__}")
    return parser


def _print_table(results: Iterable[CheckResult], works: bool) -> None:
    console = Console()
    table = Table("Part", "Status")
    table.add_column("Detail", overflow="fold")
    for result in results:
        detail = escape(result.detail)
        if result.remedy:
            detail += f"\n[bold]Remedy:[/bold] {escape(result.remedy)}"
        colour = _COLOURS[result.status]
        table.add_row(result.name, f"[{colour}]{result.status}[/{colour}]", detail)
    console.print(table)
    fails = "Something that training needs fails: see the remedies above."
    console.print("Everything that training needs works." if works else fails)
