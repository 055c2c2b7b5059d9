"""A state of a match from above: players and ball on the pitch, score and clock above it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mplsoccer import Pitch

from fbrl.density import AssistDensity, PositionDensity
from fbrl.density.coordinates import (
    HALF_LENGTH,
    HALF_WIDTH,
    METRES_PER_UNIT,
    PITCH_LENGTH,
    PITCH_WIDTH,
)
from fbrl.drawing.canvas import Colour, circle, line, text, text_width

LEFT_COLOUR: Colour = (38, 110, 235)
RIGHT_COLOUR: Colour = (214, 48, 49)
CONTROLLED_COLOUR: Colour = (255, 235, 59)
BALL_COLOUR: Colour = (255, 255, 255)
PANEL_COLOUR: Colour = (24, 29, 35)

MIN_WIDTH = 320
"""Pixels; below, the text can't be read."""

TEXT: Colour = (232, 237, 242)
FAINT: Colour = (132, 143, 155)
HIGHLIGHT: Colour = (255, 235, 59)

_MARGIN = 4.0  # grass around the pitch, where players may run, metres
_SMALLEST_UNIT = 0.62
_SMALLEST_LETTERS = 7

_OUTLINE: Colour = (15, 20, 25)
_CREDIT: Colour = (190, 215, 196)
_LEFT_DOT: Colour = (74, 140, 255)
_RIGHT_DOT: Colour = (240, 84, 84)

# Names of game_mode; normal play needs none.
_GAME_MODES = ("", "kick-off", "goal kick", "free kick", "corner", "throw-in", "penalty")


class MatchPicture:
    """Draws states of matches.

    A state has for each of :data:`fbrl.envs.rendering.DRAWN_KEYS` an array of one match.

    Args:
        width: Of the pictures, pixels, at least :data:`MIN_WIDTH` and even; the height follows from
            the pitch's proportions.
        density: Laid over the grass; ``None`` for none.

    Attributes:
        unit: Scale of what is not to the pitch's scale; 1 for pictures 960 pixels wide.
        pixels_per_metre: The pitch's scale.

    Raises:
        ValueError: The width is too small or odd.
    """

    def __init__(self, width: int, density: AssistDensity | None = None) -> None:
        if width < MIN_WIDTH or width % 2:
            raise ValueError(f"width is {width}; an even number of at least {MIN_WIDTH} is needed.")
        # Letters stop shrinking before they can't be read.
        self.unit = max(width / 960, _SMALLEST_UNIT)
        self.pixels_per_metre = width / (PITCH_LENGTH + 2 * _MARGIN)
        self._header_height = round(52 * self.unit)
        pitch_height = round((PITCH_WIDTH + 2 * _MARGIN) * self.pixels_per_metre)
        self.width, self.height = width, self._header_height + pitch_height
        self._empty = np.full((self.height, width, 3), PANEL_COLOUR, np.uint8)
        self._empty[self._header_height :] = _pitch_background(density, width, pitch_height)
        if density is not None and density.metadata is not None:
            corner = (width - 10 * self.unit, self.height - 14 * self.unit)
            text(self._empty, corner, density.metadata.credit, 11 * self.unit, _CREDIT, anchor="rm")

    def pixels(self, positions: np.ndarray) -> np.ndarray:
        """Where positions on the pitch are in a picture.

        Args:
            positions: (..., 2 or more) x and y in pitch units.

        Returns:
            (..., 2) column and row, float64.
        """
        metres = (positions[..., :2] + [HALF_LENGTH, HALF_WIDTH]) * METRES_PER_UNIT
        return (metres + _MARGIN) * self.pixels_per_metre + [0.0, self._header_height]

    def empty(self, scenario: str) -> np.ndarray:
        """What stays the same through a match: uint8 (height, width, 3), a new array."""
        frame = self._empty.copy()
        height = self._header_height
        middle, left, size = height / 2, 0.35 * height, 0.32 * height
        room = self.width / 2 - 1.7 * height - left
        size = min(size, size * room / text_width(scenario, size))
        if size >= _SMALLEST_LETTERS:
            text(frame, (left, middle), scenario, size, FAINT)
        for side, colour in ((-1, _LEFT_DOT), (1, _RIGHT_DOT)):
            centre = (self.width / 2 + side * 1.35 * height, middle)
            circle(frame, centre, 0.16 * height, colour)
        return frame

    def draw(self, frame: np.ndarray, state: Mapping[str, np.ndarray], seconds: float) -> None:
        """Draws a state, and the seconds that the clock shows, over what is always seen.

        The frame may be higher than the picture.
        """
        self._draw_players(frame, state)
        ball = self.pixels(state["ball"])
        # Nearer to the eye, and so the larger, the higher it flies.
        radius = (0.62 + 0.07 * min(float(state["ball"][2]), 10.0)) * self.pixels_per_metre
        circle(frame, ball, radius + 1.2 * self.unit, _OUTLINE)
        circle(frame, ball, radius, BALL_COLOUR)
        self._draw_score(frame, state, seconds)

    def _draw_score(
        self, frame: np.ndarray, state: Mapping[str, np.ndarray], seconds: float
    ) -> None:
        left, right = state["score"].tolist()
        height, middle = self._header_height, self._header_height / 2
        score = f"{left} : {right}"
        text(frame, (self.width / 2, middle), score, 0.52 * height, TEXT, anchor="mm", bold=True)
        clock = f"{int(seconds // 60)}:{seconds % 60:04.1f}"
        edge = self.width - 0.35 * height
        text(frame, (edge, middle), clock, 0.4 * height, TEXT, anchor="rm", bold=True)
        if mode := _GAME_MODES[int(state["game_mode"])]:
            place = (edge - 2.2 * height, middle)
            text(frame, place, mode, 0.32 * height, HIGHLIGHT, anchor="rm")

    def _draw_players(self, frame: np.ndarray, state: Mapping[str, np.ndarray]) -> None:
        radius = 1.15 * self.pixels_per_metre
        controlled = int(state["active"])
        for team, colour in (("right_team", RIGHT_COLOUR), ("left_team", LEFT_COLOUR)):
            positions = self.pixels(state[team])
            headings = state[f"{team}_direction"] * METRES_PER_UNIT
            plays = (state[f"{team}_active"] == 1) & (state[f"{team}_roles"] != -1)
            for player in np.flatnonzero(plays).tolist():
                position = positions[player]
                if team == "left_team" and player == controlled:
                    ring = max(1, round(2.4 * self.unit))
                    circle(frame, position, 1.75 * radius, CONTROLLED_COLOUR, ring)
                speed = float(np.hypot(*headings[player]))
                if speed > 0.02:  # metres a step; who stands still has no heading
                    tip = position + headings[player] / speed * 1.7 * radius
                    line(frame, position, tip, _OUTLINE, max(1, round(3 * self.unit)))
                circle(frame, position, radius + 1.3 * self.unit, _OUTLINE)
                circle(frame, position, radius, colour)


def _pitch_background(density: AssistDensity | None, width: int, height: int) -> np.ndarray:
    """An empty pitch with its margins, uint8 (height, width, 3), the attack towards the right.

    The density is laid over the grass in two colours, the stronger the higher.
    """
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    pitch = Pitch(
        pitch_type="custom",
        pitch_length=PITCH_LENGTH,
        pitch_width=PITCH_WIDTH,
        pitch_color="#2f7a45",
        stripe=True,
        stripe_color="#338049",
        line_color="#e6efe8",
        linewidth=max(0.8, width / 640),
        line_zorder=2.5,
        goal_type="box",
        goal_alpha=0.8,
        corner_arcs=True,
    )
    pitch.draw(ax=axes)
    axes.set_aspect("auto")
    axes.set_xlim(-_MARGIN, PITCH_LENGTH + _MARGIN)
    axes.set_ylim(-_MARGIN, PITCH_WIDTH + _MARGIN)
    if density is not None:
        _lay_over(axes, density.start, "#ffc233")
        _lay_over(axes, density.end, "#e94fd0")
        axes.set_aspect("auto")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _lay_over(axes: Axes, surface: PositionDensity, colour: str) -> None:
    # Rows from top to bottom, as y grows downwards in the environment.
    values = surface.grid.cpu().numpy().T
    pixels = np.empty((*values.shape, 4))
    pixels[..., :3] = to_rgb(colour)
    pixels[..., 3] = 0.72 * values
    extent = (0.0, PITCH_LENGTH, 0.0, PITCH_WIDTH)
    axes.imshow(pixels, extent=extent, interpolation="bilinear", zorder=2, aspect="auto")
