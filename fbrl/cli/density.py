"""``fbrl-density``: fits densities to real passes, prints them and draws them."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

# As in fbrl.cli.train: waiting threads must not take the cores from the matches.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from fbrl.cli.density_passes import add_pass_options, print_counts, read_passes
from fbrl.cli.density_plot import PROGRAM, add_density, add_plot
from fbrl.cli.errors import Parser, add_command, run_command
from fbrl.cli.outputs import check_outputs, console
from fbrl.density.fit import COARSEST_GRID, FINEST_GRID, PEAK_END, PEAK_START
from fbrl.density.kde import BandwidthRule

if TYPE_CHECKING:
    from fbrl.density import AssistDensity

DEFAULT_OUT = Path("assist_density.npz")

_DESCRIPTION = """\
Densities of where passes that led to goals start and end: fit them to StatsBomb's open data, to
local event files or to a table, look at them, and train on them with
fbrl-train --reward.density FILE."""

_FIT = """\
Fit a pair of densities and write them to one file. Examples:

  fbrl-density fit --competition "Premier League" --season 2015/2016 \\
                   --competition "Ligue 1" --season 2015/2016

  fbrl-density fit --csv passes.csv --filter open-play --exclude-crosses --out my.npz

  fbrl-density fit --events open-data/data/events --passes key-passes --bandwidth 4 --metres"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if it was interrupted."""
    remark = "interrupted. Matches that were downloaded are kept; run the same command to go on."
    run_command(_parser().parse_args(arguments), remark)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION)
    commands = parser.add_subparsers(metavar="{fit,plot,info}", required=True)
    _add_fit(commands)
    add_plot(commands)
    info = add_command(commands, "info", _info, "print what a density file says of itself")
    add_density(info)
    info.add_argument("--json", action="store_true", help="print it as JSON")
    return parser


def _add_fit(commands: Any) -> None:
    fit = add_command(commands, "fit", _fit, "fit a pair of densities", _FIT)
    add_pass_options(fit)
    add = fit.add_argument_group("density").add_argument
    add(
        "--bandwidth",
        type=_bandwidth,
        default="thesis",
        metavar="RULE",
        help=f"{', '.join(get_args(BandwidthRule))}, or a number",
    )
    add(
        "--metres",
        action="store_true",
        help="kernels round in metres, and a number in metres, not in pitch units "
        "(one is 54.4 m along x, 83.6 m along y)",
    )
    add(
        "--grid",
        type=int,
        metavar="COLUMNS",
        help=f"grid nodes along x, {COARSEST_GRID} to {FINEST_GRID} (default: enough for an error "
        "of at most 0.5 %% of the peak)",
    )
    add("--peak-start", type=float, default=PEAK_START, help="highest start density (%(default)s)")
    add("--peak-end", type=float, default=PEAK_END, help="highest end density (%(default)s)")
    add("--mirror", action="store_true", help="average with the left-right mirror image")
    fit.add_argument("--out", type=Path, default=DEFAULT_OUT, help="density file to write")


def _bandwidth(text: str) -> BandwidthRule | float:
    if text in get_args(BandwidthRule):
        return text  # type: ignore[return-value]  # one of its names
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(get_args(BandwidthRule))}, and no number"
        ) from None


def _fit(options: argparse.Namespace) -> None:
    from fbrl.density.fit import fit_assist_density
    from fbrl.density.passes import starts_and_ends

    check_outputs(options.out)
    reading = read_passes(options)
    print_counts(reading)
    starts, ends = starts_and_ends(reading.rows)
    density = fit_assist_density(
        starts,
        ends,
        source=options.source or " and ".join(reading.counts),
        filter=reading.description,
        credit=options.credit,
        bandwidth=options.bandwidth,
        peak_start=options.peak_start,
        peak_end=options.peak_end,
        columns=options.grid,
        metres=options.metres,
        mirror=options.mirror,
        counts=reading.counts,
    )
    density.save(options.out)
    _print_density(density)
    console().print(f"Written to {options.out}")


def _info(options: argparse.Namespace) -> None:
    from fbrl.density import open_density

    density = open_density(options.density)
    if options.json:
        print(json.dumps(_facts(density), indent=2))
    else:
        _print_density(density)


def _facts(density: AssistDensity) -> dict[str, object]:
    import dataclasses

    assert density.metadata is not None  # files and built-in densities have it
    surfaces = {
        name: {"peak": surface.peak, "grid": list(surface.grid.shape)}
        for name, surface in (("start", density.start), ("end", density.end))
    }
    return {**dataclasses.asdict(density.metadata), **surfaces}


def _print_density(density: AssistDensity) -> None:
    facts = density.metadata
    assert facts is not None
    unit = "round in metres" if facts.metres else "round in pitch units"
    rule = facts.bandwidth_rule
    kernel = rule if rule.startswith("scipy") else f"{rule}, {unit}"
    rows = {
        "source": facts.source,
        "filter": facts.filter,
        "passes": "; ".join([str(facts.n), *(f"{k}: {v}" for k, v in facts.counts.items())]),
        "bandwidth": f"{kernel}: start {facts.bandwidth_start:.4f}, end {facts.bandwidth_end:.4f}",
        "mirrored": "left to right, averaged" if facts.mirror else "no",
    }
    for name, surface in (("start", density.start), ("end", density.end)):
        columns, lines = surface.grid.shape
        rows[name] = f"peak {surface.peak:g}, grid {columns} x {lines}"
    rows["grid error"] = f"at most {facts.max_interpolation_error:.2%} of the peak"
    rows["credit"] = facts.credit
    out = console()
    for name, text in rows.items():
        out.print(f"{name:<10} {text}")
