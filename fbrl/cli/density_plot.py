"""``fbrl-density plot``: pictures of passes, densities and an agent."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from fbrl.cli.arguments import positive_integer, seed
from fbrl.cli.commands import add_command, check_outputs, console
from fbrl.cli.density_common import add_density, print_counts
from fbrl.cli.density_options import add_pass_options, pass_filter
from fbrl.cli.density_source import read_passes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    _add_figures(passes)

    densities = add_command(kinds, "densities", _plot_densities, "draw the two densities")
    add_density(densities)
    _add_figures(densities)

    agent = add_command(
        kinds, "agent", _plot_agent, "draw where an agent has had the ball, next to the densities"
    )
    played = agent.add_mutually_exclusive_group(required=True)
    played.add_argument(
        "--run", type=Path, help="directory of a run: play matches with its latest checkpoint"
    )
    played.add_argument(
        "--positions",
        type=Path,
        help="CSV table with the columns x and y in pitch units: where the agent had the ball",
    )
    agent.add_argument(
        "--matches",
        type=positive_integer,
        default=100,
        help="matches to play (default: %(default)s)",
    )
    agent.add_argument("--seed", type=seed, default=0, help="of the matches (default: %(default)s)")
    agent.add_argument("--save-positions", type=Path, help="keep what --run saw in such a table")
    agent.add_argument("--title", help="what to write above the agent's picture")
    agent.add_argument(
        "--density", default="default", help="densities to show (default: those that fbrl ships)"
    )
    _add_figures(agent)


def _add_figures(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=Path, nargs="+", required=True, help="pictures to write: .png, .svg or both"
    )


def _plot_passes(options: argparse.Namespace) -> None:
    from fbrl.figures.pitch import passes_figure

    _check_figures(options)
    reading = read_passes(options, pass_filter(options))
    if not reading.rows:
        raise ValueError(f"No pass is left to draw ({reading.description}). Use a wider filter.")
    print_counts(reading)
    source = options.source or " and ".join(reading.counts)
    title = f"{source}: {len(reading.rows)} {options.passes.replace('-', ' ')}"
    _save(options, passes_figure(reading.rows, title, options.credit))


def _plot_densities(options: argparse.Namespace) -> None:
    from fbrl.density import open_density
    from fbrl.figures.pitch import densities_figure

    _check_figures(options)
    _save(options, densities_figure(open_density(options.density)))


def _plot_agent(options: argparse.Namespace) -> None:
    from fbrl.density import open_density
    from fbrl.figures.pitch import agent_figure

    _check_figures(options)
    density = open_density(options.density)
    from fbrl.evaluation.possession import ball_positions, read_positions, write_positions

    if options.positions is not None:
        positions = read_positions(options.positions)
        title = options.title or "Where the agent has the ball"
    else:
        with Console(stderr=True).status("Playing") as status:
            positions = ball_positions(
                options.run,
                options.matches,
                seed=options.seed,
                on_progress=lambda done: status.update(f"Playing: {done} of {options.matches}"),
            )
        if not len(positions):
            raise ValueError(f"The agent of {options.run} never had the ball in these matches.")
        title = options.title or f"Where the agent has the ball, {options.matches} matches"
        if options.save_positions is not None:
            write_positions(options.save_positions, positions)
    console().print(f"{len(positions)} steps with the ball")
    _save(options, agent_figure(positions, density, title))


def _check_figures(options: argparse.Namespace) -> None:
    from fbrl.figures.files import check_figure_path

    check_outputs(*map(check_figure_path, options.out))


def _save(options: argparse.Namespace, figure: Figure) -> None:
    from fbrl.figures.files import save_figure

    save_figure(figure, *options.out)
    for path in options.out:
        console().print(f"Written to {path}")
