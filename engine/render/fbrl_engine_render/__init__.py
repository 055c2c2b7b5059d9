"""What :mod:`fbrl_engine` plays, drawn by the engine's own renderer: off-screen, without a display.

Importing it needs the libraries of SDL and EGL, and drawing a driver of OpenGL, such as Mesa's.
"""

from __future__ import annotations

import os
from pathlib import Path

# Its classes are those of what is handed over.
import fbrl_engine  # noqa: F401

from fbrl_engine_render import _native

DATA = Path(__file__).parent / "data"
"""All that the engine draws with, and what it plays with."""


class Renderer(_native.Renderer):
    """The one engine of a process that draws; it takes some seconds to make it.

    Args:
        width: Of the frames, pixels.
        height: Likewise.

    Raises:
        ValueError: No frame can be of that size.
        RuntimeError: The process has made one before, or there is no OpenGL.

    Only the thread that made it may call it. ``reset(config)`` sets a match up, from a
    ``ScenarioConfig`` of :mod:`fbrl_engine`; ``set_state(state)`` then shows a state of that match,
    bytes that the ``get_state()`` of an engine returned; and ``render()`` draws what is shown: red,
    green and blue, uint8 (height, width, 3), the upper row first.

    Examples:
        The first state of a match, ``engine`` being a ``GameEnv`` that was reset to ``config``::

            renderer = Renderer(640, 360)
            renderer.reset(config)
            renderer.set_state(engine.get_state(""))
            frame = renderer.render()
    """

    def __init__(self, width: int, height: int) -> None:
        # The shaders are of OpenGL 3.2, which Mesa offers only where that version is asked for.
        os.environ.setdefault("MESA_GL_VERSION_OVERRIDE", "3.2")
        os.environ.setdefault("MESA_GLSL_VERSION_OVERRIDE", "150")
        super().__init__(width, height, str(DATA))
