"""``render()`` of the environments, and Gymnasium's wrappers that call it."""

from __future__ import annotations

import sys
import types

import gymnasium
import numpy as np
import psutil
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import AddRenderObservation, HumanRendering, RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo

import fbrl.envs.rendering
from fbrl.checks import MissingExtraError, UnknownNameError
from fbrl.drawing.match_picture import BALL_COLOUR, CONTROLLED_COLOUR, MatchPicture
from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.envs.engine import FIRST_EPISODE
from fbrl.envs.engine_pictures import EnginePictures, RenderingError
from fbrl.envs.rendering import DRAWN_KEYS, draw_from_above
from fbrl.watch.video import write_video

ID = "fbrl/academy_empty_goal_close-v0"
SCENARIO = "academy_empty_goal_close"
SHOT = 12
SHAPE = (464, 640, 3)


@pytest.fixture
def moviepy(monkeypatch):
    """What ``RecordVideo`` writes files with, or the part of it that it uses."""
    try:
        import moviepy.video.io.ImageSequenceClip  # noqa: F401
    except ImportError:

        class ImageSequenceClip:
            def __init__(self, frames, fps):
                self.frames, self.fps = frames, fps

            def write_videofile(self, path, logger=None):
                write_video(path, self.frames, self.fps)

        for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
            monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        module = types.ModuleType("moviepy.video.io.ImageSequenceClip")
        module.ImageSequenceClip = ImageSequenceClip
        monkeypatch.setitem(sys.modules, module.__name__, module)


def video(path):
    """Frames per second, and the frames, of a file."""
    from imageio_ffmpeg import read_frames

    frames = read_frames(path)
    metadata = next(frames)
    width, height = metadata["size"]
    shape = (height, width, 3)
    return metadata["fps"], [np.frombuffer(frame, np.uint8).reshape(shape) for frame in frames]


def play_to_the_end(env):
    env.reset(seed=1)
    steps, ended = 0, False
    while not ended:
        *_, terminated, truncated, _ = env.step(SHOT)
        steps, ended = steps + 1, terminated or truncated
    return steps


def test_a_picture_shows_where_players_and_ball_are():
    env = FootballEnv(SCENARIO, ["ball", "left_team", "active"], render_mode="rgb_array")
    env.reset(seed=1)
    for _ in range(3):
        observation, *_ = env.step(5)
    assert set(observation) == {"ball", "left_team", "active"}
    frame = env.render()
    assert (frame.shape, frame.dtype) == (SHAPE, np.uint8)
    pixels = MatchPicture(640).pixels
    column, row = np.round(pixels(observation["ball"])).astype(int)
    assert (np.abs(frame[row, column].astype(int) - BALL_COLOUR) < 40).all()
    controlled = observation["left_team"][observation["active"].item()]
    column, row = np.round(pixels(controlled)).astype(int)
    around = frame[row - 12 : row + 13, column - 12 : column + 13].reshape(-1, 3).astype(int)
    assert (np.abs(around - CONTROLLED_COLOUR) < 10).all(-1).any()
    again = env.render()
    again[:] = 0
    np.testing.assert_array_equal(env.render(), frame)
    env.close()


def test_the_last_picture_is_of_what_ended_the_episode():
    env = FootballEnv(SCENARIO, render_mode="rgb_array")
    env.reset(seed=1)
    ended = False
    while not ended:
        observation, reward, ended, *_ = env.step(SHOT)
    assert reward == 1.0
    state = {key: observation[key].squeeze() for key in DRAWN_KEYS}
    np.testing.assert_array_equal(env.render(), draw_from_above(SCENARIO, state))
    env.close()


def test_record_video_writes_a_file_of_an_episode(moviepy, tmp_path):
    env = gymnasium.make(ID, render_mode="rgb_array")
    env = RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True)
    steps = play_to_the_end(env)
    last = env.unwrapped.render()
    env.close()
    (path,) = tmp_path.glob("*.mp4")
    fps, frames = video(path)
    assert fps == 10
    assert len(frames) == steps + 1
    assert frames[0].shape == SHAPE
    assert np.abs(frames[-1].astype(int) - last).mean() < 4
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100


def test_record_video_writes_a_file_of_several_matches(moviepy, tmp_path):
    env = FootballVectorEnv(SCENARIO, num_envs=2, render_mode="rgb_array")
    env = RecordVectorVideo(env, str(tmp_path), step_trigger=lambda step: step == 0, video_length=4)
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.array([5, 5]))
    env.close()
    (path,) = tmp_path.glob("*.mp4")
    assert video(path)[0] == 10


def test_add_render_observation_observes_the_picture():
    env = AddRenderObservation(gymnasium.make(ID, render_mode="rgb_array"))
    picture, _ = env.reset(seed=1)
    assert env.observation_space.contains(picture)
    np.testing.assert_array_equal(picture, env.render())
    env.close()


def test_human_rendering_shows_it(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = HumanRendering(gymnasium.make(ID, render_mode="rgb_array"))
    env.reset(seed=1)
    env.step(5)
    env.close()


def test_passes_gymnasiums_checks():
    env = gymnasium.make(ID, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()


def test_several_matches_are_drawn_each():
    env = FootballVectorEnv(
        SCENARIO, num_envs=3, observation_keys=["ball"], render_mode="rgb_array"
    )
    env.reset(seed=[1, 2, 3])
    observation, *_ = env.step(np.array([5, 1, 12]))
    assert set(observation) == {"ball"}
    frames = env.render()
    assert isinstance(frames, tuple)
    assert [(frame.shape, str(frame.dtype)) for frame in frames] == [(SHAPE, "uint8")] * 3
    alone = FootballEnv(SCENARIO, render_mode="rgb_array")
    for frame, seed, action in zip(frames, (1, 2, 3), (5, 1, 12), strict=True):
        alone.reset(seed=seed)
        alone.step(action)
        np.testing.assert_array_equal(frame, alone.render())
    alone.close()
    env.close()


def test_a_match_that_ended_is_drawn_until_it_is_reset():
    env = FootballVectorEnv(SCENARIO, num_envs=1, render_mode="rgb_array")
    env.reset(seed=[1])
    (first,) = env.render()
    ended = False
    while not ended:
        observation, _, (ended,), *_ = env.step(np.array([SHOT]))
    state = {key: observation[key][0] for key in DRAWN_KEYS}
    np.testing.assert_array_equal(env.render()[0], draw_from_above(SCENARIO, state))
    env.reset(seed=[1], options={"reset_mask": np.array([True])})
    np.testing.assert_array_equal(env.render()[0], first)
    env.close()


def test_without_a_render_mode_nothing_is_drawn():
    for env in (FootballEnv(SCENARIO), FootballVectorEnv(SCENARIO)):
        env.reset(seed=1)
        assert env.render() is None
        env.close()


def test_what_can_not_be_drawn_is_said_at_once(monkeypatch):
    with pytest.raises(UnknownNameError, match="render_mode"):
        FootballEnv(SCENARIO, render_mode="ansi")
    with pytest.raises(UnknownNameError, match="view"):
        FootballEnv(SCENARIO, render_mode="rgb_array", view="4d")
    with pytest.raises(UnknownNameError, match="render_mode"):
        FootballVectorEnv(SCENARIO, render_mode="human")
    monkeypatch.setattr(fbrl.envs.rendering, "_PACKAGES", ("nothing_of_this_name",))
    with pytest.raises(MissingExtraError, match="nothing_of_this_name"):
        FootballEnv(SCENARIO, render_mode="rgb_array")


@pytest.mark.slow
def test_the_engine_draws_episodes_of_an_environment():
    env = FootballEnv(SCENARIO, ["ball"], render_mode="rgb_array", view="3d")
    env.reset(seed=3)
    first = env.render()
    (process,) = [
        p for p in psutil.Process().children() if "fbrl.envs.render_process" in p.cmdline()
    ]
    env.step(5)
    np.testing.assert_array_equal(env.render(), env.render())
    for _ in range(2):
        env.step(SHOT)
    third = env.render()
    env.reset(seed=4)
    other = env.render()
    with EnginePictures(640, 360) as pictures:
        ((_, expected_first),) = pictures.play((SCENARIO, 3, FIRST_EPISODE))
        ((_, expected_third),) = pictures.play(None, [5, SHOT, SHOT])
        ((_, expected_other),) = pictures.play((SCENARIO, 4, FIRST_EPISODE))
        ((_, expected_last),) = pictures.play(None, [5])
    np.testing.assert_array_equal(first, expected_first)
    np.testing.assert_array_equal(third, expected_third)
    np.testing.assert_array_equal(other, expected_other)
    assert len({frame.tobytes() for frame in (first, third, other)}) == 3
    # The process that comes after one that is gone plays the episode from its beginning.
    env.step(5)
    process.kill()
    with pytest.raises(RenderingError, match="SIGKILL"):
        env.render()
    np.testing.assert_array_equal(env.render(), expected_last)
    env.close()
