"""A recorded match from above: players, ball, passes, and the reward as it comes in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbrl.density import AssistDensity
from fbrl.drawing.canvas import Colour, arrow, blend, circle, line
from fbrl.drawing.match_picture import (
    BALL_COLOUR,
    LEFT_COLOUR,
    PANEL_COLOUR,
    RIGHT_COLOUR,
    MatchPicture,
)
from fbrl.watch.panels import ActionPanel, RewardStrip
from fbrl.watch.recording import MatchRecording

TRAIL_FRAMES = 15
"""How long the ball's trail is."""

PASS_FRAMES = 25
"""How long a pass is shown after it was received."""

# No ball flies this far in a frame; it was put there, after a goal say.
_JUMP_METRES = 10.0


class PitchView:
    """Draws recorded matches from above.

    Args:
        density: Laid over the grass; ``None`` for a reward without densities.
        width: Of the frames, pixels, at least :data:`~fbrl.drawing.match_picture.MIN_WIDTH`; the
            height follows from the pitch's proportions. Both are even, as videos need them.

    Raises:
        ValueError: The width is too small or odd.

    Examples:
        Pictures of the matches that a policy plays, and a video of them::

            view = PitchView(AssistDensity.default(), width=960)
            for match in record_matches(policy, "academy_3_vs_1_with_keeper", ...):
                write_video("match.mp4", view.frames(match), fps=1 / match.seconds_per_step)
    """

    def __init__(self, density: AssistDensity | None, width: int = 960) -> None:
        self._picture = MatchPicture(width, density)
        unit = self._unit = self._picture.unit
        strip_top = self._picture.height
        height = strip_top + round(128 * unit)
        self.width, self.height = width, height + height % 2
        self._strip = np.full((self.height - strip_top, width, 3), PANEL_COLOUR, np.uint8)
        self._actions = ActionPanel((0, strip_top), unit)
        self._strip_box = (round(224 * unit), strip_top, width, self.height)
        self.pixels = self._picture.pixels

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Draws every state of a match, the first one included.

        Yields:
            Red, green and blue, uint8 (height, width, 3); each frame is a new array.
        """
        base = np.concatenate([self._picture.empty(recording.scenario), self._strip])
        strip = RewardStrip(recording, self._strip_box, self._unit)
        strip.draw_empty(base)
        ball = self.pixels(recording.observations["ball"])
        trail = max(1, TRAIL_FRAMES // recording.frame_skip)
        farthest = _JUMP_METRES * recording.frame_skip
        trail_starts = self._trail_starts(ball, trail, farthest)
        passes = completed_passes(recording)
        for index in range(recording.num_steps + 1):
            frame = base.copy()
            self._draw_last_pass(frame, passes, index, PASS_FRAMES // recording.frame_skip)
            self._draw_trail(frame, ball[trail_starts[index] : index + 1], trail)
            state = {key: array[index] for key, array in recording.observations.items()}
            self._picture.draw(frame, state, index * recording.seconds_per_step)
            self._actions.draw(frame, recording, index)
            strip.draw(frame, index)
            yield frame

    def _trail_starts(self, ball: np.ndarray, length: int, farthest: float) -> list[int]:
        """For each state the first one that the ball's trail reaches back to."""
        flights = np.hypot(*np.diff(ball, axis=0).T) / self._picture.pixels_per_metre
        first = 0
        starts = [0]
        for index, metres in enumerate(flights.tolist(), start=1):
            first = index if metres > farthest else max(first, index - length)
            starts.append(first)
        return starts

    def _draw_last_pass(
        self, frame: np.ndarray, passes: list[CompletedPass], index: int, steps: int
    ) -> None:
        past = [completed for completed in passes if completed.received_at <= index]
        if not past or index - past[-1].received_at > steps:
            return
        start, end = self.pixels(past[-1].start), self.pixels(past[-1].end)
        colour = (LEFT_COLOUR, RIGHT_COLOUR)[past[-1].team]
        bright: Colour = tuple(round(0.45 * c + 0.55 * 255) for c in colour)  # type: ignore[assignment]
        circle(frame, start, 0.5 * self._picture.pixels_per_metre, bright)
        arrow(frame, start, end, bright, max(1, round(2.2 * self._unit)))

    def _draw_trail(self, frame: np.ndarray, points: np.ndarray, length: int) -> None:
        # A mask, so that the older parts let the grass shine through.
        corner = np.floor(points.min(0)).astype(int) - 4
        columns, rows = np.ceil(points.max(0)).astype(int) + 5 - corner
        mask = np.zeros((rows, columns), np.uint8)
        thickness = max(1, round(3 * self._unit))
        for age, (start, end) in enumerate(zip(points[-2::-1], points[:0:-1], strict=True)):
            strength = round(230 * (1 - age / length))
            line(mask, start - corner, end - corner, (strength, 0, 0), thickness)
        blend(frame, mask, (int(corner[0]), int(corner[1])), BALL_COLOUR)


@dataclass(frozen=True)
class CompletedPass:
    """A ball that went from one player of a team to another, from x and y to x and y."""

    team: int  # 0 is the left one
    received_at: int  # index of the first state in which the receiver has the ball
    start: np.ndarray  # where the passer had it last, pitch units
    end: np.ndarray  # where the receiver has it first


def completed_passes(recording: MatchRecording) -> list[CompletedPass]:
    """The passes in play, of either team, in their order."""
    observations = recording.observations
    ball = observations["ball"][:, :2]
    owners = zip(
        observations["ball_owned_team"].tolist(),
        observations["ball_owned_player"].tolist(),
        observations["game_mode"].tolist(),
        strict=True,
    )
    passes = []
    carrier: tuple[int, int] | None = None
    carried_at = 0
    for index, (team, player, game_mode) in enumerate(owners):
        if game_mode != 0:
            carrier = None
        elif team != -1:
            if carrier is not None and carrier[0] == team and carrier[1] != player:
                passes.append(CompletedPass(team, index, ball[carried_at], ball[index]))
            carrier, carried_at = (team, player), index
    return passes
