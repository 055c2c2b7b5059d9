"""The views that there are of a match, by their names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from fbrl.checks.names import check_name
from fbrl.density import AssistDensity
from fbrl.watch.engine_view import EngineView
from fbrl.watch.pitch_view import PitchView
from fbrl.watch.recording import MatchRecording


class View(Protocol):
    """What draws recorded matches."""

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Yields a picture of each state, uint8 (height, width, 3)."""


class SideBySide:
    """Two views in step.

    Args:
        left: One of them.
        right: The other, of the same height.
    """

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
