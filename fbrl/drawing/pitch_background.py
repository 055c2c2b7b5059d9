"""The pitch that a match is drawn on: grass, lines, and the densities that a reward uses."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mplsoccer import Pitch

from fbrl.density import AssistDensity, PositionDensity
from fbrl.density.coordinates import PITCH_LENGTH, PITCH_WIDTH

MARGIN = 4.0
"""Grass around the pitch, where players may run, metres."""

START_COLOUR = "#ffc233"
END_COLOUR = "#e94fd0"

_GRASS = "#2f7a45"
_STRIPE = "#338049"
_LINES = "#e6efe8"
_STRONGEST = 0.72
_DOTS_PER_INCH = 100


def pitch_background(density: AssistDensity | None, width: int, height: int) -> np.ndarray:
    """Draws an empty pitch in its real proportions, the attack towards the right.

    Args:
        density: Laid over the grass in two colours, the stronger the higher; ``None`` for grass.
        width: Pixels for the pitch and the margins left and right of it.
        height: Likewise from top to bottom.

    Returns:
        Red, green and blue, uint8 (height, width, 3).
    """
    size = (width / _DOTS_PER_INCH, height / _DOTS_PER_INCH)
    figure = Figure(figsize=size, dpi=_DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    pitch = Pitch(
        pitch_type="custom",
        pitch_length=PITCH_LENGTH,
        pitch_width=PITCH_WIDTH,
        pitch_color=_GRASS,
        stripe=True,
        stripe_color=_STRIPE,
        line_color=_LINES,
        linewidth=max(0.8, width / 640),
        line_zorder=2.5,
        goal_type="box",
        goal_alpha=0.8,
        corner_arcs=True,
    )
    pitch.draw(ax=axes)
    axes.set_aspect("auto")
    axes.set_xlim(-MARGIN, PITCH_LENGTH + MARGIN)
    axes.set_ylim(-MARGIN, PITCH_WIDTH + MARGIN)
    if density is not None:
        _lay_over(axes, density.start, START_COLOUR)
        _lay_over(axes, density.end, END_COLOUR)
        axes.set_aspect("auto")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _lay_over(axes: Axes, surface: PositionDensity, colour: str) -> None:
    # Rows from top to bottom, as y grows downwards in the environment.
    values = surface.grid.cpu().numpy().T
    pixels = np.empty((*values.shape, 4))
    pixels[..., :3] = to_rgb(colour)
    pixels[..., 3] = _STRONGEST * values
    axes.imshow(
        pixels,
        extent=(0.0, PITCH_LENGTH, 0.0, PITCH_WIDTH),
        interpolation="bilinear",
        zorder=2,
        aspect="auto",
    )
