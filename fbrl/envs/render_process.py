"""The process in which the engine draws: ``python -m fbrl.envs.render_process``.

:class:`fbrl.envs.engine_pictures.EnginePictures` starts it, and says what it reads and writes.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from fbrl_engine_render import Renderer

from fbrl.envs.engine import build_scenario

# Off-screen the engine's pictures come out dark, half of the pixels below a tenth of the range.
_GAMMA = 1.7
_BRIGHTER = np.rint(255 * (np.arange(256) / 255) ** (1 / _GAMMA)).astype(np.uint8)


def main(width: int, height: int, descriptor: int) -> None:
    """Draws pictures of ``width`` x ``height`` pixels to a descriptor until the input ends."""
    renderer = Renderer(width, height)
    with os.fdopen(descriptor, "wb") as output:
        for line in sys.stdin:
            for _ in _play(renderer, **json.loads(line)):
                positions = renderer.positions()
                output.write(np.int32(len(positions)).tobytes())
                output.write(positions.tobytes())
                output.write(_BRIGHTER[renderer.render()].tobytes())
            output.flush()


def _play(
    renderer: Any,
    episode: tuple[str, int, int] | None,
    actions: Sequence[int],
    frame_skip: int,
    every: bool,
) -> Iterator[None]:
    """Stops at each state that is asked for."""
    if episode is not None:
        renderer.reset(build_scenario(*episode))
        if every:
            yield
    for action in actions:
        # Drawn by render() at its end otherwise, not in each of the frames.
        renderer.step(action, draw=every and frame_skip == 1, frame_skip=frame_skip)
        if every:
            yield
    if not every:
        yield


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
