"""The engine's own pictures, beside those of gfootball as pip builds it, without a display."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fbrl.envs.engine import FIRST_EPISODE
from fbrl.envs.engine_pictures import EnginePictures

# As `scripts/setup.sh --default-engine` makes it.
GFOOTBALL = Path(__file__).parent.parent / "build" / "default-engine"

# Right, sprint, short pass, shot, upper right: the ball moves, and so does the camera.
PLAYED = """
MATCHES = [("academy_3_vs_1_with_keeper", 1, 2), ("11_vs_11_easy_stochastic", 6, 3)]
ACTIONS = [5, 13, 5, 11, 5, 12, 4, 11]
WIDTH, HEIGHT = 320, 180
"""

# What is drawn in play, and what is drawn of a state after another one. Gfootball draws with the
# field of view of the picture before: a second picture is of the state alone.
UPSTREAM = f"""{PLAYED}
import sys
import gfootball_engine
import numpy as np
from fbrl.envs.engine import build_scenario
from fbrl.envs.engine import load_gfootball

action_set = load_gfootball().action_set.action_set_dict["default"]
backend = [action._backend_action for action in action_set]
engine = gfootball_engine.GameEnv()
engine.game_config.render = True
engine.game_config.render_resolution_x, engine.game_config.render_resolution_y = WIDTH, HEIGHT
engine.start_game()

def step():
    engine.step()
    while not engine.get_info().is_in_play:
        engine.step()

def picture():
    return np.frombuffer(engine.get_frame(), np.uint8).reshape(HEIGHT, WIDTH, 3)[::-1]

played, restored, states = [], [], []
for match in MATCHES:
    engine.reset(build_scenario(*match), False)
    while not engine.get_info().is_in_play:
        engine.step()
    engine.render(True)
    of_match = [engine.get_state("")]
    played.append(picture())
    for action in ACTIONS:
        engine.perform_action(backend[action], True, 0)
        step()
        of_match.append(engine.get_state(""))
        played.append(picture())
    for state in of_match:
        engine.set_state(state)
        engine.render(True)
        engine.render(True)
        restored.append(picture())
    states += of_match
np.savez(sys.argv[1], played=played, restored=restored, states=np.array(states, object))
"""

OURS = f"""{PLAYED}
import sys
import numpy as np
from fbrl_engine_render import Renderer
from fbrl.envs.engine import build_scenario

states = list(np.load(sys.argv[2], allow_pickle=True)["states"])
renderer = Renderer(WIDTH, HEIGHT)
played, restored, jumped = [], [], []
for match in MATCHES:
    renderer.reset(build_scenario(*match))
    played.append(renderer.render())
    for action in ACTIONS:
        renderer.step(action)
        played.append(renderer.render())
    of_match, states = states[: len(ACTIONS) + 1], states[len(ACTIONS) + 1 :]
    backwards = []
    for state in of_match[::-1]:
        renderer.set_state(state)
        backwards.append(renderer.render())
    restored += backwards[::-1]
    renderer.reset(build_scenario(*match))
    for action in ACTIONS:
        renderer.step(action, draw=False)
    jumped.append(renderer.render())
np.savez(sys.argv[1], played=played, restored=restored, jumped=jumped)
for wrong in (
    lambda: Renderer(WIDTH, HEIGHT),
    lambda: renderer.set_state(b"not a state"),
    lambda: renderer.step(20),
):
    try:
        wrong()
    except Exception as error:
        print(type(error).__name__, error)
"""


def run(program: str, *arguments: object, path: Path | None = None) -> str:
    # In a process of its own: the engine renders in one instance of a process only.
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    if path is not None:
        environment["PYTHONPATH"] = os.pathsep.join([str(path), *sys.path[1:]])
    process = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.slow
@pytest.mark.skipif(not GFOOTBALL.is_dir(), reason="asks for scripts/setup.sh --default-engine")
def test_frames_are_those_of_gfootball(tmp_path):
    run(UPSTREAM, tmp_path / "upstream.npz", path=GFOOTBALL)
    printed = run(OURS, tmp_path / "ours.npz", tmp_path / "upstream.npz")
    with (
        np.load(tmp_path / "upstream.npz", allow_pickle=True) as upstream,
        np.load(tmp_path / "ours.npz") as ours,
    ):
        assert ours["played"].shape == (18, 180, 320, 3)
        assert ours["played"].std() > 10
        np.testing.assert_array_equal(ours["played"], upstream["played"])
        np.testing.assert_array_equal(ours["restored"], upstream["restored"])
        np.testing.assert_array_equal(ours["jumped"], upstream["restored"][8::9])
    one, state, action = printed.splitlines()
    assert one.startswith("RuntimeError This process has made its Renderer")
    assert state.startswith("ValueError the engine's state, of 11 bytes, is not that of a match")
    assert action == "ValueError There is no action 20."


@pytest.mark.slow
def test_a_picture_shows_the_pitch_whatever_its_width():
    # OpenGL's rows begin at multiples of four bytes, unless it is told otherwise.
    with EnginePictures(318, 180) as pictures:
        ((positions, picture),) = pictures.play(("academy_3_vs_1_with_keeper", 1, FIRST_EPISODE))
        (first, second) = pictures.play(None, [5, 5], every=True)
        ((_, fourth),) = pictures.play(None, [5, 5])
    assert positions.shape == (3 + 2 * 6,)
    assert not np.array_equal(positions, first[0])
    assert (picture.shape, picture.dtype) == ((180, 318, 3), np.uint8)
    red, green, blue = picture.reshape(-1, 3).mean(0)
    assert green > red + 10 > 20, "mostly grass, neither black nor sky"
    assert green > blue + 10
    assert (picture.min(axis=-1) > 120).mean() > 0.001, "with white lines"
    # Rows that were shifted against each other would differ from their neighbours everywhere.
    across = np.abs(np.diff(picture.astype(int), axis=0)).mean()
    along = np.abs(np.diff(picture.astype(int), axis=1)).mean()
    assert across < 2 * along
    assert len({drawn.tobytes() for drawn in (picture, first[1], second[1], fourth)}) == 4
