"""The engine's picture of a match, without a display."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np

PROGRAM = """
import sys
import numpy as np
from fbrl.envs.rendering import render_frame
np.save(sys.argv[1], render_frame("academy_3_vs_1_with_keeper", seed=1, width=320, height=180))
"""


def test_a_frame_shows_the_pitch(tmp_path):
    # In a process of its own: the engine renders in one instance of a process only.
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path / "frame.npy"], check=True, env=environment
    )
    frame = np.load(tmp_path / "frame.npy")
    assert (frame.shape, frame.dtype) == ((180, 320, 3), np.uint8)
    red, green, blue = frame.reshape(-1, 3).mean(0)
    assert green > red + 10 > 20, "mostly grass, neither black nor sky"
    assert green > blue + 10
    assert (frame.min(axis=-1) > 120).mean() > 0.001, "with white lines"
