"""What is written below the pitch: the action held, the reward's parts."""

from __future__ import annotations

import numpy as np

from fbrl.drawing.canvas import Colour, arrow, circle, rectangle, text
from fbrl.drawing.match_picture import FAINT, HIGHLIGHT, TEXT
from fbrl.envs.actions import ACTION_NAMES
from fbrl.watch.recording import MatchRecording

_ACTIONS = (*(name.replace("_", " ") for name in ACTION_NAMES), "built-in AI")

_DARK: Colour = (38, 45, 53)
_LANE: Colour = (33, 39, 46)
_NEGATIVE: Colour = (240, 84, 84)

_PART_COLOURS: dict[str, Colour] = {
    "reward_scoring": (94, 214, 130),
    "reward_start_density": (255, 194, 51),
    "reward_end_density": (233, 79, 208),
}
_OTHER_PART: Colour = (96, 190, 240)

# Unit vectors of the eight directions in the order of the sticky actions, y downwards.
_DIRECTIONS = np.array(
    [(-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1)], float
)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


class ActionPanel:
    """The action that led to a state, and what is held: direction, sprint, dribble.

    Its upper left corner is column and row, its unit 1 for frames 960 pixels wide.
    """

    def __init__(self, corner: tuple[int, int], unit: float) -> None:
        self._corner, self._unit = corner, unit

    def draw(self, frame: np.ndarray, recording: MatchRecording, index: int) -> None:
        """Draws the panel of a state."""
        unit = self._unit
        left, top = self._corner[0] + 18 * unit, self._corner[1]
        name = _ACTIONS[recording.actions[index - 1]] if index else ""
        text(frame, (left, top + 22 * unit), "ACTION", 11 * unit, FAINT, bold=True)
        text(frame, (left, top + 43 * unit), name, 18 * unit, TEXT, bold=True)
        held = recording.observations["sticky_actions"][index]
        centre = (left + 24 * unit, top + 90 * unit)
        circle(frame, centre, 24 * unit, _DARK)
        for direction in _DIRECTIONS[held[:8] == 1]:
            tail, tip = (np.array(centre) + sign * 16 * unit * direction for sign in (-1, 1))
            arrow(frame, tail, tip, HIGHLIGHT, max(1, round(3 * unit)))
        for row, (word, flag) in enumerate((("sprint", held[8]), ("dribble", held[9]))):
            height = top + (78 + 25 * row) * unit
            circle(frame, (left + 68 * unit, height), 5 * unit, HIGHLIGHT if flag else _DARK)
            colour = TEXT if flag else FAINT
            text(frame, (left + 81 * unit, height), word, 13 * unit, colour)


class RewardStrip:
    """A lane for each part of the reward, which fills up as the match goes on.

    Its box is left, top, right and bottom in pixels, its unit 1 for frames 960 pixels wide.
    """

    def __init__(
        self, recording: MatchRecording, box: tuple[int, int, int, int], unit: float
    ) -> None:
        left, top, right, bottom = box
        self._unit = unit
        self._steps = recording.num_steps
        self._names = list(recording.rewards)
        self._sums = [
            np.concatenate([[0.0], np.cumsum(part, dtype=np.float64)])
            for part in recording.rewards.values()
        ]
        self._label_left, self._value_right = left, round(right - 18 * unit)
        self._chart_left = left + round(132 * unit)
        self._chart_width = max(1, self._value_right - round(78 * unit) - self._chart_left)
        pad = round(12 * unit)
        self._height = (bottom - top - 2 * pad) // len(self._names)
        self._tops = [top + pad + row * self._height for row in range(len(self._names))]
        gap = max(1, round(4 * unit))
        self._charts = [
            self._chart(part, self._height - gap, _part_colour(name))
            for name, part in recording.rewards.items()
        ]

    def _chart(self, part: np.ndarray, height: int, colour: Colour) -> np.ndarray:
        """The whole lane, uint8 (height, chart width, 3), scaled to its highest bar."""
        chart = np.full((height, self._chart_width, 3), _LANE, np.uint8)
        highest = float(np.abs(part).max())
        has_loss = bool((part < 0).any())
        zero = height // 2 if has_loss else height - 1
        reach = max(1, zero - 1)
        chart[zero] = _DARK
        if highest == 0:
            return chart
        for step in np.flatnonzero(part).tolist():
            first = self._column(step)
            last = max(self._column(step + 1), first + max(1, round(2 * self._unit)))
            length = max(1, round(abs(float(part[step])) / highest * reach))
            rows = slice(zero - length, zero) if part[step] > 0 else slice(zero + 1, zero + length)
            chart[rows, first:last] = colour if part[step] > 0 else _NEGATIVE
        return chart

    def _column(self, step: int) -> int:
        return step * self._chart_width // self._steps

    def draw_empty(self, frame: np.ndarray) -> None:
        """Draws what stays the same through a match: names and empty lanes."""
        for name, top, chart in zip(self._names, self._tops, self._charts, strict=True):
            middle = top + chart.shape[0] / 2
            words = name.removeprefix("reward_").replace("_", " ")
            size = 13 * self._unit
            text(frame, (self._label_left, middle), words, size, _part_colour(name))
            rectangle(frame, (self._chart_left, top), (self._chart_width, chart.shape[0]), _LANE)

    def draw(self, frame: np.ndarray, index: int) -> None:
        """Draws the lanes up to a state, and each part's sum so far."""
        now = self._column(index)
        for top, chart, sums in zip(self._tops, self._charts, self._sums, strict=True):
            height = chart.shape[0]
            lane = frame[top : top + height, self._chart_left :]
            lane[:, :now] = chart[:, :now]
            lane[:, max(0, now - 1) : now] = FAINT
            middle = top + height / 2
            amount = f"{sums[index]:+.3f}" if sums[index] else "0"
            place = (self._value_right, middle)
            text(frame, place, amount, 13 * self._unit, TEXT, anchor="rm")


def _part_colour(name: str) -> Colour:
    return _PART_COLOURS.get(name, _OTHER_PART)
