"""What ``render()`` of the environments returns: a match from above, or as the engine draws it."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fbrl.checks import MissingExtraError, check_name, missing_packages
from fbrl.envs.engine_pictures import EnginePictures
from fbrl.scenarios import SECONDS_PER_FRAME

if TYPE_CHECKING:
    from fbrl.drawing.match_picture import MatchPicture

View = Literal["2d", "3d"]
"""From above, some milliseconds a picture; or the engine's own, some tenths of a second."""

RENDER_METADATA: dict[str, Any] = {
    "render_modes": ["rgb_array"],
    "render_fps": 1 / SECONDS_PER_FRAME,
}


def render_metadata(frame_skip: int) -> dict[str, Any]:
    """What Gymnasium's wrappers film by, in real time."""
    return RENDER_METADATA | {"render_fps": RENDER_METADATA["render_fps"] / frame_skip}


WIDTH = 640
"""Of the pictures, pixels."""

_TEAM_KEYS = ("team", "team_direction", "team_active", "team_roles")

DRAWN_KEYS = (
    "ball",
    *(f"{side}_{key}" for side in ("left", "right") for key in _TEAM_KEYS),
    "active",
    "game_mode",
    "score",
    "steps_left",
)
"""What of an observation is seen from above."""

_PACKAGES = ("cv2", "matplotlib", "mplsoccer")


def check_render_mode(render_mode: str | None, view: str = "2d") -> str | None:
    """The render mode, if there is such a one and its view can be drawn.

    Raises:
        UnknownNameError: There is no such mode or view.
        MissingExtraError: Packages are missing.
    """
    check_name("view", view, ("2d", "3d"))
    if render_mode is not None:
        check_name("render_mode", render_mode, RENDER_METADATA["render_modes"])
        if view == "2d" and (missing := missing_packages(_PACKAGES)):
            raise MissingExtraError("Pictures", missing, "analysis")
    return render_mode


def draw_from_above(scenario: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Draws a state of a match; the clock shows the time that is left.

    Args:
        scenario: Its name, which is written over it.
        state: Array of one match for each of :data:`DRAWN_KEYS`.

    Returns:
        Red, green and blue, uint8 (height, :data:`WIDTH`, 3), of an even height.
    """
    picture = _match_picture()
    frame = picture.empty(scenario)
    picture.draw(frame, state, int(state["steps_left"]) * SECONDS_PER_FRAME)
    # Videos are of even sizes.
    return frame[: picture.height // 2 * 2]


@functools.cache
def _match_picture() -> MatchPicture:
    # Matplotlib takes long to import.
    from fbrl.drawing.match_picture import MatchPicture

    return MatchPicture(WIDTH)


class EpisodeInEngine:
    """Episodes of a scenario as the engine draws them, which plays along where it is asked to."""

    def __init__(self, scenario: str, frame_skip: int) -> None:
        self._scenario = scenario
        self._frame_skip = frame_skip
        self._pictures = EnginePictures(WIDTH, WIDTH * 9 // 16)
        self.close = self._pictures.close

    def begin(self, seed: int, episode_number: int) -> None:
        """Notes that an episode has begun."""
        self._episode = self._scenario, seed, episode_number
        self._actions: list[int] = []
        # How many the engine that draws has played, None if it has not begun the episode.
        self._drawn: int | None = None

    def step(self, action: int) -> None:
        """Notes that an action was played."""
        self._actions.append(action)

    def draw(self) -> np.ndarray:
        """The last state, or a ``RenderingError``; see :meth:`EnginePictures.play`."""
        if self._drawn != len(self._actions):
            begun, self._drawn = self._drawn, None
            episode = self._episode if begun is None else None
            actions = self._actions[begun or 0 :]
            ((_, self._picture),) = self._pictures.play(episode, actions, self._frame_skip)
            self._drawn = len(self._actions)
        return self._picture.copy()
