"""A recorded match from above: players, ball, passes, and the reward as it comes in."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fbrl.density import AssistDensity
from fbrl.density.pitch import HALF_LENGTH, HALF_WIDTH, METRES_PER_UNIT
from fbrl.watch.canvas import Colour, arrow, blend, circle, line, text
from fbrl.watch.panels import ActionPanel, Header, RewardStrip
from fbrl.watch.passes import CompletedPass, completed_passes
from fbrl.watch.pitch_background import LENGTH, MARGIN, WIDTH, pitch_background
from fbrl.watch.recording import MatchRecording

LEFT_COLOUR: Colour = (38, 110, 235)
RIGHT_COLOUR: Colour = (214, 48, 49)
CONTROLLED_COLOUR: Colour = (255, 235, 59)
BALL_COLOUR: Colour = (255, 255, 255)
PANEL_COLOUR: Colour = (24, 29, 35)

MIN_WIDTH = 320
"""Pixels; below, the text can't be read."""

TRAIL_STEPS = 15
"""How long the ball's trail is."""

PASS_STEPS = 25
"""How long a pass is shown after it was received."""

# No ball flies this far in a step; it was put there, after a goal say.
_JUMP_METRES = 10.0

_SMALLEST_UNIT = 0.62

_OUTLINE: Colour = (15, 20, 25)
_CREDIT: Colour = (190, 215, 196)
_TEAMS = (("left_team", LEFT_COLOUR), ("right_team", RIGHT_COLOUR))


class PitchView:
    """Draws recorded matches from above.

    Args:
        density: Laid over the grass; ``None`` for a reward without densities.
        width: Of the frames, pixels, at least :data:`MIN_WIDTH`; the height follows from the
            pitch's proportions. Both are even, as videos need them.

    Raises:
        ValueError: The width is too small or odd.

    Examples:
        Pictures of the matches that a policy plays, and a video of them::

            view = PitchView(AssistDensity.default(), width=960)
            for match in record_matches(policy, "academy_3_vs_1_with_keeper", ...):
                write_video("match.mp4", view.frames(match))
    """

    def __init__(self, density: AssistDensity | None, width: int = 960) -> None:
        if width < MIN_WIDTH or width % 2:
            raise ValueError(f"width is {width}; an even number of at least {MIN_WIDTH} is needed.")
        # Letters stop shrinking before they can't be read.
        unit = max(width / 960, _SMALLEST_UNIT)
        self._pixels_per_metre = width / (LENGTH + 2 * MARGIN)
        self._header_height = round(52 * unit)
        pitch_height = round((WIDTH + 2 * MARGIN) * self._pixels_per_metre)
        strip_height = round(128 * unit)
        height = self._header_height + pitch_height + strip_height
        self.width, self.height = width, height + height % 2
        self._blank = np.full((self.height, width, 3), PANEL_COLOUR, np.uint8)
        strip_top = self._header_height + pitch_height
        self._blank[self._header_height : strip_top] = pitch_background(
            density, width, pitch_height
        )
        if density is not None and density.metadata is not None:
            corner = (width - 10 * unit, strip_top - 14 * unit)
            text(self._blank, corner, density.metadata.credit, 11 * unit, _CREDIT, anchor="rm")
        self._header = Header(width, self._header_height)
        self._actions = ActionPanel((0, strip_top), unit)
        self._strip_box = (round(224 * unit), strip_top, width, self.height)
        self._unit = unit

    def pixels(self, positions: np.ndarray) -> np.ndarray:
        """Where positions on the pitch are in a frame.

        Args:
            positions: (..., 2 or more) x and y in pitch units.

        Returns:
            (..., 2) column and row, float64.
        """
        metres = (positions[..., :2] + [HALF_LENGTH, HALF_WIDTH]) * METRES_PER_UNIT
        return (metres + MARGIN) * self._pixels_per_metre + [0.0, self._header_height]

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Draws every state of a match, the first one included.

        Yields:
            Red, green and blue, uint8 (height, width, 3); each frame is a new array.
        """
        base = self._blank.copy()
        self._header.draw_names(base, recording)
        strip = RewardStrip(recording, self._strip_box, self._unit)
        strip.draw_empty(base)
        ball = self.pixels(recording.observations["ball"])
        trail_starts = self._trail_starts(ball)
        passes = completed_passes(recording)
        for index in range(recording.num_steps + 1):
            frame = base.copy()
            self._draw_last_pass(frame, passes, index)
            self._draw_trail(frame, ball[trail_starts[index] : index + 1])
            self._draw_players(frame, recording, index)
            self._draw_ball(frame, ball[index], float(recording.observations["ball"][index, 2]))
            self._header.draw(frame, recording, index)
            self._actions.draw(frame, recording, index)
            strip.draw(frame, index)
            yield frame

    def _trail_starts(self, ball: np.ndarray) -> list[int]:
        """For each state the first one that the ball's trail reaches back to."""
        flights = np.hypot(*np.diff(ball, axis=0).T) / self._pixels_per_metre
        first = 0
        starts = [0]
        for index, metres in enumerate(flights.tolist(), start=1):
            first = index if metres > _JUMP_METRES else max(first, index - TRAIL_STEPS)
            starts.append(first)
        return starts

    def _draw_last_pass(self, frame: np.ndarray, passes: list[CompletedPass], index: int) -> None:
        last = max((p for p in passes if p.received_at <= index), default=None, key=_received_at)
        if last is None or index - last.received_at > PASS_STEPS:
            return
        start, end = self.pixels(last.start), self.pixels(last.end)
        colour = _TEAMS[last.team][1]
        bright: Colour = tuple(round(0.45 * c + 0.55 * 255) for c in colour)  # type: ignore[assignment]
        circle(frame, start, 0.5 * self._pixels_per_metre, bright)
        arrow(frame, start, end, bright, max(1, round(2.2 * self._unit)))

    def _draw_trail(self, frame: np.ndarray, points: np.ndarray) -> None:
        # A mask, so that the older parts let the grass shine through.
        corner = np.floor(points.min(0)).astype(int) - 4
        columns, rows = np.ceil(points.max(0)).astype(int) + 5 - corner
        mask = np.zeros((rows, columns), np.uint8)
        thickness = max(1, round(3 * self._unit))
        for age, (start, end) in enumerate(zip(points[-2::-1], points[:0:-1], strict=True)):
            strength = round(230 * (1 - age / TRAIL_STEPS))
            line(mask, start - corner, end - corner, (strength, 0, 0), thickness)
        blend(frame, mask, (int(corner[0]), int(corner[1])), BALL_COLOUR)

    def _draw_players(self, frame: np.ndarray, recording: MatchRecording, index: int) -> None:
        observations = recording.observations
        radius = 1.15 * self._pixels_per_metre
        controlled = int(observations["active"][index])
        for team, colour in reversed(_TEAMS):
            positions = self.pixels(observations[team][index])
            headings = observations[f"{team}_direction"][index] * METRES_PER_UNIT
            plays = observations[f"{team}_active"][index] == 1
            plays &= observations[f"{team}_roles"][index] != -1
            for player in np.flatnonzero(plays).tolist():
                marked = team == "left_team" and player == controlled
                if marked:
                    circle(frame, positions[player], 1.75 * radius, CONTROLLED_COLOUR,
                           max(1, round(2.4 * self._unit)))  # fmt: skip
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
            line(frame, position, tip, _OUTLINE, max(1, round(3 * self._unit)))
        circle(frame, position, radius + 1.3 * self._unit, _OUTLINE)
        circle(frame, position, radius, colour)

    def _draw_ball(self, frame: np.ndarray, position: np.ndarray, metres_high: float) -> None:
        # Nearer to the eye, and so the larger, the higher it flies.
        radius = (0.62 + 0.07 * min(metres_high, 10.0)) * self._pixels_per_metre
        circle(frame, position, radius + 1.2 * self._unit, _OUTLINE)
        circle(frame, position, radius, BALL_COLOUR)


def _received_at(completed: CompletedPass) -> int:
    return completed.received_at
