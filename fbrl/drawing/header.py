"""What is written above the pitch: scenario, score and clock."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fbrl.drawing.canvas import Colour, circle, text, text_width

GAME_MODES = ("", "kick-off", "goal kick", "free kick", "corner", "throw-in", "penalty")
"""Names of ``game_mode``; normal play needs none."""

SECONDS_PER_STEP = 0.1

TEXT: Colour = (232, 237, 242)
FAINT: Colour = (132, 143, 155)
HIGHLIGHT: Colour = (255, 235, 59)

_SMALLEST_LETTERS = 7

_LEFT: Colour = (74, 140, 255)
_RIGHT: Colour = (240, 84, 84)


class Header:
    """Scenario, score, and clock, across the top.

    Args:
        width: Pixels.
        height: Likewise.
    """

    def __init__(self, width: int, height: int) -> None:
        self._width, self._height = width, height

    def draw_names(self, frame: np.ndarray, scenario: str) -> None:
        """Draws what stays the same through a match."""
        middle, left, size = self._height / 2, 0.35 * self._height, 0.32 * self._height
        room = self._width / 2 - 1.7 * self._height - left
        size = min(size, size * room / text_width(scenario, size))
        if size >= _SMALLEST_LETTERS:
            text(frame, (left, middle), scenario, size, FAINT)
        for side, colour in ((-1, _LEFT), (1, _RIGHT)):
            centre = (self._width / 2 + side * 1.35 * self._height, middle)
            circle(frame, centre, 0.16 * self._height, colour)

    def draw(self, frame: np.ndarray, state: Mapping[str, np.ndarray], seconds: float) -> None:
        """Draws the score of a state, and what the clock shows."""
        left, right = state["score"].tolist()
        middle = self._height / 2
        size = 0.52 * self._height
        text(frame, (self._width / 2, middle), f"{left} : {right}", size, TEXT, anchor="mm",
             bold=True)  # fmt: skip
        clock = f"{int(seconds // 60)}:{seconds % 60:04.1f}"
        edge = self._width - 0.35 * self._height
        text(frame, (edge, middle), clock, 0.4 * self._height, TEXT, anchor="rm", bold=True)
        mode = GAME_MODES[int(state["game_mode"])]
        if mode:
            text(frame, (edge - 2.2 * self._height, middle), mode, 0.32 * self._height, HIGHLIGHT,
                 anchor="rm")  # fmt: skip
