"""The engine's own picture of a match, drawn off-screen without a display."""

from __future__ import annotations

import numpy as np

from fbrl.envs.engine import FIRST_EPISODE, build_scenario
from fbrl.envs.gfootball_import import load_gfootball
from fbrl.envs.scenarios import check_scenario


def render_frame(
    scenario: str, *, seed: int = 0, width: int = 640, height: int = 360
) -> np.ndarray:
    """Draws the first step of an episode.

    The engine can render in one instance of a process only, and takes about ten seconds to set
    it up: call this in a process of its own.

    Args:
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        seed: Engine seed of the episode.
        width: Of the picture, pixels.
        height: Likewise.

    Returns:
        Red, green and blue, uint8 of shape (height, width, 3).

    Raises:
        UnknownNameError: There is no such scenario.
        EngineNotInstalledError: gfootball is missing.
    """
    check_scenario(scenario)
    gfootball = load_gfootball()
    engine = gfootball.engine.GameEnv()
    engine.game_config.render = True
    engine.game_config.render_resolution_x = width
    engine.game_config.render_resolution_y = height
    engine.start_game()
    engine.state = gfootball.engine.GameState.game_running
    engine.reset(build_scenario(scenario, seed, FIRST_EPISODE), False)
    # A step draws its end; before one the camera is not in place.
    engine.step()
    pixels = np.frombuffer(engine.get_frame(), np.uint8).reshape(height, width, 3)
    # OpenGL's first row is the lowest.
    return np.flip(pixels, 0).copy()
