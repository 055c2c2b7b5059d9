"""``fbrl-plot``: draws what runs have logged, as figures for papers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from fbrl.cli.errors import Parser
from fbrl.cli.plot_bars import add_bars
from fbrl.cli.plot_curves import add_curves
from fbrl.cli.subcommands import run_command

PROGRAM = "fbrl-plot"

_DESCRIPTION = """\
Draw figures for papers from what fbrl-train and fbrl-eval have written, as PNG or SVG by the name's
ending; several names give several files. Needs pip install 'fbrl[analysis]'."""

_EPILOG = """\
examples (more of them: fbrl-plot curves --help, fbrl-plot bars --help):
  fbrl-plot curves runs/academy_3_vs_1_with_keeper/* --out curves.png curves.svg
  fbrl-plot bars runs/*/* --out goals.png"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if it was interrupted."""
    run_command(_parser().parse_args(arguments), "interrupted; nothing was written")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, epilog=_EPILOG)
    commands = parser.add_subparsers(metavar="{curves,bars}", required=True)
    add_curves(commands)
    add_bars(commands)
    return parser
