"""The engine's own pictures of a match, drawn off-screen without a display.

The engine can render in one instance of a process only, and takes five to fifteen seconds to set it
up: what is here belongs into a process of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from fbrl.envs.engine import FIRST_EPISODE, Match
from fbrl.envs.gfootball_import import load_gfootball
from fbrl.envs.scenarios import check_scenario

# Off-screen the engine's pictures come out dark, half of the pixels below a tenth of the range.
_GAMMA = 1.7
_BRIGHTER = np.rint(255 * (np.arange(256) / 255) ** (1 / _GAMMA)).astype(np.uint8)


def start_rendering_engine(width: int, height: int) -> Any:
    """Starts the one engine of this process that renders.

    Args:
        width: Of its pictures, pixels.
        height: Likewise.

    Raises:
        EngineNotInstalledError: gfootball is missing.
    """
    engine = load_gfootball().engine.GameEnv()
    engine.game_config.render = True
    engine.game_config.render_resolution_x = width
    engine.game_config.render_resolution_y = height
    engine.start_game()
    return engine


def render_match(
    engine: Any, scenario: str, seed: int, episode_number: int, actions: Iterable[int]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Plays a match once more and draws each of its states, the first one included.

    Args:
        engine: From :func:`start_rendering_engine`.
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        seed: Engine seed of the episode.
        episode_number: As for :meth:`fbrl.envs.engine.Match.reset`.
        actions: Of every step; none draws the first state alone.

    Yields:
        Positions, float32 (3 + 2 * players,): x, y and z of the ball, then x and y of each player
        of the left and of the right team; and the picture, red, green and blue, uint8 of shape
        (height, width, 3).

    Raises:
        UnknownNameError: There is no such scenario.
    """
    match = Match(check_scenario(scenario), engine)
    match.reset(seed, episode_number)
    engine.render(True)
    yield _positions(engine), _picture(engine)
    for action in actions:
        match.step(action)
        yield _positions(engine), _picture(engine)


def render_frame(
    scenario: str, *, seed: int = 0, width: int = 640, height: int = 360
) -> np.ndarray:
    """Draws the first state of an episode; once in a process.

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
    engine = start_rendering_engine(width, height)
    _, picture = next(render_match(engine, scenario, seed, FIRST_EPISODE, ()))
    return picture


def _positions(engine: Any) -> np.ndarray:
    info = engine.get_info()
    ball = info.ball_position
    values = [ball[0], ball[1], ball[2]]
    for player in (*info.left_team, *info.right_team):
        values += player.position[0], player.position[1]
    return np.array(values, np.float32)


def _picture(engine: Any) -> np.ndarray:
    config = engine.game_config
    shape = (config.render_resolution_y, config.render_resolution_x, 3)
    # OpenGL's first row is the lowest.
    return _BRIGHTER[np.frombuffer(engine.get_frame(), np.uint8).reshape(shape)[::-1]]
