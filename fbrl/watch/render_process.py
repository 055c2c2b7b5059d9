"""The process in which the engine renders: ``python -m fbrl.watch.render_process``.

Reads matches from standard input, one JSON object with ``scenario``, ``engine_seed``,
``episode_number`` and ``actions`` in each line. For each of their states it writes to the file
descriptor that it is given: the positions, float32, and the picture, uint8, as
:func:`fbrl.envs.rendering.render_match` yields them. It ends with its input.
"""

from __future__ import annotations

import json
import os
import sys

from fbrl.envs.rendering import render_match, start_rendering_engine


def main(width: int, height: int, descriptor: int) -> None:
    """Renders until the input ends.

    Args:
        width: Of the pictures, pixels.
        height: Likewise.
        descriptor: Where to write.
    """
    engine = start_rendering_engine(width, height)
    with os.fdopen(descriptor, "wb") as output:
        for line in sys.stdin:
            match = json.loads(line)
            for positions, picture in render_match(
                engine,
                match["scenario"],
                match["engine_seed"],
                match["episode_number"],
                match["actions"],
            ):
                output.write(positions.tobytes())
                output.write(picture.tobytes())
            output.flush()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
