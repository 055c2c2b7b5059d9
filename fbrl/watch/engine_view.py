"""A recorded match as the engine itself draws it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from fbrl.envs.engine_pictures import EnginePictures, RenderingError
from fbrl.watch.recording import MatchRecording


class EngineView:
    """Draws recorded matches with the engine, in a process of its own.

    The match is played once more from its seed and its actions; that every player, and the ball, is
    where the recording has it is checked at every step.

    Args:
        width: Of the frames, pixels, even.
        height: Likewise.

    As a context manager it ends the process, which otherwise ends with this one.

    Examples:
        A video of matches in three dimensions::

            with EngineView(width=640, height=360) as view:
                for match in matches:
                    write_video("match.mp4", view.frames(match))
    """

    def __init__(self, width: int = 640, height: int = 360) -> None:
        self._pictures = EnginePictures(width, height)
        self.start = self._pictures.start
        self.close = self._pictures.close

    def __enter__(self) -> EngineView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Draws every state of a match, the first one included.

        Yields:
            Red, green and blue, uint8 (height, width, 3).

        Raises:
            RenderingError: The process ended, hangs, or plays another match than was recorded.
        """
        episode = recording.scenario, recording.engine_seed, recording.episode_number
        play = self._pictures.play(
            episode, recording.actions.tolist(), recording.frame_skip, every=True
        )
        with contextlib.closing(play) as played:
            for index, (positions, picture) in enumerate(played):
                if not np.array_equal(positions, _positions(recording, index)):
                    raise RenderingError(
                        f"The engine does not play {recording.scenario} with seed "
                        f"{recording.engine_seed} as it was recorded: at step {index} the "
                        "positions differ. Record it anew with the engine that is installed."
                    )
                yield picture


def _positions(recording: MatchRecording, index: int) -> np.ndarray:
    """What :meth:`EnginePictures.play` yields as positions of a state, as it was recorded."""
    state = {key: array[index] for key, array in recording.observations.items()}
    teams = [state[team][state[f"{team}_roles"] != -1] for team in ("left_team", "right_team")]
    return np.concatenate([state["ball"], *map(np.ravel, teams)]).astype(np.float32)
