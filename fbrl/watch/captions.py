"""What is said of a match before it begins and after it has ended, over its pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fbrl.drawing.canvas import text
from fbrl.drawing.header import SECONDS_PER_STEP
from fbrl.watch.recording import MatchRecording
from fbrl.watch.views import View

CAPTION_SECONDS = 1.2
"""How long the first and the last picture of a match stand still under their captions."""

_WHITE = (255, 255, 255)
_BRIGHTNESS = 0.4


def captioned_frames(
    view: View, recording: MatchRecording, title: str, fps: float
) -> Iterator[np.ndarray]:
    """The pictures of a match with its title before and its result after them.

    Args:
        view: Draws them.
        recording: The match.
        title: Stands in the first line, above the scenario and the seed.
        fps: Frames per second, which the captions' length follows.
    """
    still = _still_frames(fps)
    frame = None
    for frame in view.frames(recording):
        if still:
            seed = f"{recording.scenario}, engine seed {recording.engine_seed}"
            opening = _caption(frame, title, seed)
            for _ in range(still):
                yield opening
            still = 0
        yield frame
    assert frame is not None  # a match has at least one state
    closing = _caption(frame, *_result(recording))
    for _ in range(_still_frames(fps)):
        yield closing


def num_frames(recording: MatchRecording, fps: float) -> int:
    """How many frames :func:`captioned_frames` yields."""
    return recording.num_steps + 1 + 2 * _still_frames(fps)


def _still_frames(fps: float) -> int:
    return max(1, round(CAPTION_SECONDS * fps))


def _result(recording: MatchRecording) -> tuple[str, str]:
    left, right = recording.score
    seconds = f"{recording.num_steps * SECONDS_PER_STEP:.1f} s"
    if left + right == 1:
        line = f"{'goal' if left else 'goal against'} after {seconds}"
    else:
        line = f"{left + right or 'no'} goals in {seconds}"
    return f"{left} : {right}", line


def _caption(frame: np.ndarray, headline: str, line: str) -> np.ndarray:
    dimmed = np.rint(frame * _BRIGHTNESS).astype(np.uint8)
    height, width = dimmed.shape[:2]
    unit = min(width / 960, height / 540)
    text(dimmed, (width / 2, 0.45 * height), headline, 54 * unit, _WHITE, anchor="mm", bold=True)
    text(dimmed, (width / 2, 0.45 * height + 52 * unit), line, 22 * unit, _WHITE, anchor="mm")
    return dimmed
