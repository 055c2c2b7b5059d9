"""A state of a match from above: players and ball on the pitch, score and clock above it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fbrl.density import AssistDensity
from fbrl.density.coordinates import (
    HALF_LENGTH,
    HALF_WIDTH,
    METRES_PER_UNIT,
    PITCH_LENGTH,
    PITCH_WIDTH,
)
from fbrl.drawing.canvas import Colour, circle, line, text
from fbrl.drawing.header import Header
from fbrl.drawing.pitch_background import MARGIN, pitch_background

LEFT_COLOUR: Colour = (38, 110, 235)
RIGHT_COLOUR: Colour = (214, 48, 49)
CONTROLLED_COLOUR: Colour = (255, 235, 59)
BALL_COLOUR: Colour = (255, 255, 255)
PANEL_COLOUR: Colour = (24, 29, 35)

MIN_WIDTH = 320
"""Pixels; below, the text can't be read."""

_SMALLEST_UNIT = 0.62

_OUTLINE: Colour = (15, 20, 25)
_CREDIT: Colour = (190, 215, 196)
_TEAMS = (("left_team", LEFT_COLOUR), ("right_team", RIGHT_COLOUR))


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
        self.pixels_per_metre = width / (PITCH_LENGTH + 2 * MARGIN)
        self._header_height = round(52 * self.unit)
        pitch_height = round((PITCH_WIDTH + 2 * MARGIN) * self.pixels_per_metre)
        self.width, self.height = width, self._header_height + pitch_height
        self._empty = np.full((self.height, width, 3), PANEL_COLOUR, np.uint8)
        self._empty[self._header_height :] = pitch_background(density, width, pitch_height)
        if density is not None and density.metadata is not None:
            corner = (width - 10 * self.unit, self.height - 14 * self.unit)
            text(self._empty, corner, density.metadata.credit, 11 * self.unit, _CREDIT, anchor="rm")
        self._header = Header(width, self._header_height)

    def pixels(self, positions: np.ndarray) -> np.ndarray:
        """Where positions on the pitch are in a picture.

        Args:
            positions: (..., 2 or more) x and y in pitch units.

        Returns:
            (..., 2) column and row, float64.
        """
        metres = (positions[..., :2] + [HALF_LENGTH, HALF_WIDTH]) * METRES_PER_UNIT
        return (metres + MARGIN) * self.pixels_per_metre + [0.0, self._header_height]

    def empty(self, scenario: str) -> np.ndarray:
        """What stays the same through a match: uint8 (height, width, 3), a new array."""
        frame = self._empty.copy()
        self._header.draw_names(frame, scenario)
        return frame

    def draw(self, frame: np.ndarray, state: Mapping[str, np.ndarray], seconds: float) -> None:
        """Draws a state over what is always seen.

        Args:
            frame: Uint8 (height or more, width, 3).
            state: Of the match.
            seconds: What the clock shows.
        """
        self._draw_players(frame, state)
        self._draw_ball(frame, self.pixels(state["ball"]), float(state["ball"][2]))
        self._header.draw(frame, state, seconds)

    def _draw_players(self, frame: np.ndarray, state: Mapping[str, np.ndarray]) -> None:
        radius = 1.15 * self.pixels_per_metre
        controlled = int(state["active"])
        for team, colour in reversed(_TEAMS):
            positions = self.pixels(state[team])
            headings = state[f"{team}_direction"] * METRES_PER_UNIT
            plays = (state[f"{team}_active"] == 1) & (state[f"{team}_roles"] != -1)
            for player in np.flatnonzero(plays).tolist():
                marked = team == "left_team" and player == controlled
                if marked:
                    circle(frame, positions[player], 1.75 * radius, CONTROLLED_COLOUR,
                           max(1, round(2.4 * self.unit)))  # fmt: skip
                self._draw_player(frame, positions[player], headings[player], radius, colour)

    def _draw_player(
        self,
        frame: np.ndarray,
        position: np.ndarray,
        heading: np.ndarray,
        radius: float,
        colour: Colour,
    ) -> None:
        speed = float(np.hypot(*heading))
        if speed > 0.02:  # metres a step; who stands still has no heading
            tip = position + heading / speed * 1.7 * radius
            line(frame, position, tip, _OUTLINE, max(1, round(3 * self.unit)))
        circle(frame, position, radius + 1.3 * self.unit, _OUTLINE)
        circle(frame, position, radius, colour)

    def _draw_ball(self, frame: np.ndarray, position: np.ndarray, metres_high: float) -> None:
        # Nearer to the eye, and so the larger, the higher it flies.
        radius = (0.62 + 0.07 * min(metres_high, 10.0)) * self.pixels_per_metre
        circle(frame, position, radius + 1.2 * self.unit, _OUTLINE)
        circle(frame, position, radius, BALL_COLOUR)
