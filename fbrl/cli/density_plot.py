"""``fbrl-density plot``: pictures of passes, densities and an agent."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbrl.allocator import preload_tcmalloc
from fbrl.cli.arguments import add_import, positive_integer, seed
from fbrl.cli.density_passes import add_pass_options, print_counts, read_passes
from fbrl.cli.errors import add_command, playing
from fbrl.cli.outputs import (
    ProgressDisplay,
    add_figure_option,
    check_figure_outputs,
    console,
    write_figure,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PROGRAM = "fbrl-density"

_PLOT = """\
Draw a picture, as PNG or SVG by the name's ending; several names give several files. Examples:

  fbrl-density plot densities --out densities.png densities.svg

  fbrl-density plot passes --csv passes.csv --out passes.png

  fbrl-density plot agent --run runs/academy_3_vs_1_with_keeper/my-run --out agent.png"""


def add_plot(commands: Any) -> None:
    """Adds the subcommand with its three kinds of pictures."""
    plot = add_command(commands, "plot", None, "draw passes, densities or an agent", _PLOT)
    kinds = plot.add_subparsers(metavar="{passes,densities,agent}", required=True)

    passes = add_command(
        kinds, "passes", _plot_passes, "draw passes from start (red) to end (blue)"
    )
    add_pass_options(passes)
    add_figure_option(passes)

    densities = add_command(kinds, "densities", _plot_densities, "draw the two densities")
    add_density(densities)
    add_figure_option(densities)

    agent = add_command(
        kinds, "agent", _plot_agent, "draw where an agent has had the ball, next to the densities"
    )
    add = agent.add_argument
    played = agent.add_mutually_exclusive_group(required=True)
    played.add_argument(
        "--run",
        type=Path,
        help="directory of a run: play matches with its latest checkpoint; or pretrained:NAME",
    )
    played.add_argument(
        "--positions",
        type=Path,
        help="CSV table with the columns x and y in pitch units: where the agent had the ball",
    )
    add(
        "--episodes",
        type=positive_integer,
        default=100,
        help="matches to play, rounded up to 2 for each of 8 at a time",
    )
    add_import(agent)
    add("--seed", type=seed, default=0, help="of the matches")
    add("--save-positions", type=Path, help="keep what --run saw in such a table")
    add("--title", help="what to write above the agent's picture")
    add("--density", default="default", help="densities to show (default: those that fbrl ships)")
    add_figure_option(agent)


def add_density(parser: argparse.ArgumentParser) -> None:
    """Adds the positional argument that names a density."""
    parser.add_argument(
        "density",
        nargs="?",
        default="default",
        metavar="DENSITY",
        help="density file, or default, uniform, mirrored or shuffled",
    )


def _plot_passes(options: argparse.Namespace) -> None:
    from fbrl.figures.pitch import passes_figure

    check_figure_outputs(options)
    reading = read_passes(options)
    if not reading.rows:
        raise ValueError(f"No pass is left to draw ({reading.description}). Use a wider filter.")
    source = options.source or " and ".join(reading.counts)
    title = f"{source}: {len(reading.rows)} {options.passes.replace('-', ' ')}"
    write_figure(options, passes_figure(reading.rows, title, options.credit))
    print_counts(reading)


def _plot_densities(options: argparse.Namespace) -> None:
    from fbrl.density import open_density
    from fbrl.figures.pitch import densities_figure

    check_figure_outputs(options)
    write_figure(options, densities_figure(open_density(options.density)))


def _plot_agent(options: argparse.Namespace) -> None:
    if options.run is not None:
        # First of all, as it starts the program anew.
        preload_tcmalloc(PROGRAM)
    check_figure_outputs(options, options.save_positions)
    if options.positions is not None and options.save_positions is not None:
        raise ValueError("--save-positions is for what --run sees, not for --positions.")
    from fbrl.density import open_density
    from fbrl.figures.pitch import agent_figure, check_installed
    from fbrl.figures.positions import read_positions

    check_installed()  # before the matches
    density = open_density(options.density)
    title = "Where the agent has the ball"
    if options.run is None:
        positions = read_positions(options.positions)
    else:
        positions = _play(options)
        title += f", {options.episodes} matches"
    write_figure(options, agent_figure(positions, density, options.title or title))
    console().print(f"{len(positions)} steps with the ball")


def _play(options: argparse.Namespace) -> NDArray[np.float64]:
    from fbrl.evaluation.possession import ball_positions
    from fbrl.figures.positions import write_positions

    wanted = options.episodes
    with playing(PROGRAM), ProgressDisplay() as display:
        positions = ball_positions(
            options.run,
            wanted,
            seed=options.seed,
            on_progress=lambda done: display.show("Playing", min(done, wanted), wanted, "matches"),
        )
    if not len(positions):
        raise ValueError(f"The agent of {options.run} never had the ball in these matches.")
    if options.save_positions is not None:
        write_positions(options.save_positions, positions)
    return positions
