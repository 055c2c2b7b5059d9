"""The views that there are of a match, by their names, and what stands over their pictures."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from fbrl.checks import check_name
from fbrl.density import AssistDensity
from fbrl.drawing.canvas import text
from fbrl.watch.engine_view import EngineView
from fbrl.watch.pitch_view import PitchView
from fbrl.watch.recording import MatchRecording

CAPTION_SECONDS = 1.2
"""How long the first and the last picture of a match stand still under their captions."""


class View(Protocol):
    """What draws recorded matches."""

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Yields a picture of each state, uint8 (height, width, 3)."""


class SideBySide:
    """Two views of the same height in step."""

    def __init__(self, left: View, right: View) -> None:
        self._left, self._right = left, right

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Yields both pictures of each state as one."""
        pairs = zip(self._left.frames(recording), self._right.frames(recording), strict=True)
        for left, right in pairs:
            yield np.hstack([left, right])


@contextlib.contextmanager
def open_view(name: str, width: int, density: AssistDensity | None) -> Iterator[View]:
    """Makes a view for as long as the block lasts.

    Args:
        name: ``"2d"`` (from above), ``"3d"`` (the engine's own) or ``"both"`` (side by side).
        width: Of the frames, pixels: even, or a multiple of four for both.
        density: Of the reward, shown from above; ``None`` if it has none.

    Raises:
        UnknownNameError: There is no such view.
        ValueError: The width is too small or odd.
    """
    check_name("view", name, ("2d", "3d", "both"))
    if name == "2d":
        yield PitchView(density, width)
    elif name == "3d":
        # Pictures of the shape 16:9, of an even height.
        with EngineView(width, 2 * round(width * 9 / 32)) as view:
            yield view
    else:
        pitch = PitchView(density, width // 2)
        with EngineView(pitch.width, pitch.height) as engine:
            engine.start()
            yield SideBySide(pitch, engine)


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
    frames = view.frames(recording)
    frame = next(frames)
    seed = f"{recording.scenario}, engine seed {recording.engine_seed}"
    yield from [_caption(frame, title, seed)] * still
    yield frame
    for frame in frames:
        yield frame
    left, right = recording.score
    seconds = f"{recording.num_steps * recording.seconds_per_step:.1f} s"
    if left + right == 1:
        result = f"{'goal' if left else 'goal against'} after {seconds}"
    else:
        result = f"{left + right or 'no'} goals in {seconds}"
    yield from [_caption(frame, f"{left} : {right}", result)] * still


def num_frames(recording: MatchRecording, fps: float) -> int:
    """How many frames :func:`captioned_frames` yields."""
    return recording.num_steps + 1 + 2 * _still_frames(fps)


def _still_frames(fps: float) -> int:
    return max(1, round(CAPTION_SECONDS * fps))


def _caption(frame: np.ndarray, headline: str, line: str) -> np.ndarray:
    """A darker picture with two lines in its middle."""
    dimmed = np.rint(frame * 0.4).astype(np.uint8)
    height, width = dimmed.shape[:2]
    unit, white = min(width / 960, height / 540), (255, 255, 255)
    text(dimmed, (width / 2, 0.45 * height), headline, 54 * unit, white, anchor="mm", bold=True)
    text(dimmed, (width / 2, 0.45 * height + 52 * unit), line, 22 * unit, white, anchor="mm")
    return dimmed
