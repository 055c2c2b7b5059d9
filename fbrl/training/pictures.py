"""Pictures of a policy's matches, as the files that TensorBoard shows."""

from __future__ import annotations

import io
import itertools
import tempfile
from pathlib import Path

from numpy.typing import ArrayLike

from fbrl.density import AssistDensity
from fbrl.transforms import ScoringReward
from fbrl.watch.recording import MatchRecording

_DOTS_PER_INCH = 90
_VIDEO_WIDTH = 480
_FRAMES = 200
_STEPS_PER_FRAME = 2
# Twice as fast as it was played: ten steps are a second.
_FRAMES_PER_SECOND = 10.0


class MatchPictures:
    """Draws where an agent has the ball, and films its matches.

    Args:
        reward: What the agent is paid. Its densities are drawn; where it has none, those that fbrl
            ships stand beside the agent's positions, and the film goes without.
    """

    def __init__(self, reward: ScoringReward) -> None:
        self._paid = reward.density

    def positions(self, positions: ArrayLike) -> bytes:
        """A PNG of the ball's positions, (n, 2) in pitch units, beside the densities."""
        from fbrl.figures.pitch import agent_figure

        figure = agent_figure(
            positions,
            self._paid or AssistDensity.default(),
            "Where the agent has the ball",
            is_paid=self._paid is not None,
        )
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=_DOTS_PER_INCH, bbox_inches="tight")
        return file.getvalue()

    def film(self, match: MatchRecording) -> bytes:
        """An animated GIF of a match from above: its first 40 seconds, at twice their speed.

        Raises:
            OSError: There is no room for it.
        """
        # cv2 and ffmpeg are loaded only here: nothing else in a training needs them.
        from fbrl.watch.pitch_view import PitchView
        from fbrl.watch.video import write_video

        frames = PitchView(self._paid, _VIDEO_WIDTH).frames(match)
        shown = itertools.islice(frames, 0, _FRAMES * _STEPS_PER_FRAME, _STEPS_PER_FRAME)
        with tempfile.TemporaryDirectory(prefix="fbrl-video-") as folder:
            path = Path(folder, "match.gif")
            write_video(path, shown, fps=_FRAMES_PER_SECOND)
            return path.read_bytes()
