"""``fbrl-watch``, as a user runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from conftest import needs_engine
from watching import recorded_matches

from fbrl.cli.watch import main
from fbrl.density import AssistDensity
from fbrl.drawing.match_picture import BALL_COLOUR, CONTROLLED_COLOUR, LEFT_COLOUR
from fbrl.envs.engine import load_gfootball
from fbrl.watch.pitch_view import PitchView
from fbrl.watch.replay_file import load_replay, save_replay
from fbrl.watch.views import CAPTION_SECONDS

SCENARIO = "academy_empty_goal_close"
SHOOT = 12
CAPTION = round(10 * CAPTION_SECONDS)


@pytest.fixture
def watch(tmp_path, monkeypatch, capsys):
    """Runs the command in an empty directory, in this process, which has imported torch."""
    monkeypatch.chdir(tmp_path)
    handler = signal.getsignal(signal.SIGTERM)

    def run(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        return ended.value.code, *capsys.readouterr()

    yield run
    signal.signal(signal.SIGTERM, handler)


@needs_engine
def test_an_agents_goals_are_shown_and_kept(shooter, watch, tmp_path):
    code, output, errors = watch(
        shooter, "--only", "goals", "--episodes", 2, "--seed", 3, "--width", 640,
        "--out", "goals.mp4", "--save-replay", "goals.npz",
    )  # fmt: skip
    assert (code, errors) == (0, "")
    matches, density = load_replay(tmp_path / "goals.npz")
    assert [match.score for match in matches] == [(1, 0), (1, 0)]
    assert density.metadata == AssistDensity.default().metadata
    count = sum(match.num_steps + 1 + 2 * CAPTION for match in matches)
    assert f"goals.mp4: 2 matches, {count} frames" in output

    video = iio.imread(tmp_path / "goals.mp4")
    view = PitchView(density, 640)
    assert video.shape == (count, view.height, 640, 3)
    match = matches[0]
    for index in (1, match.num_steps - 2):
        frame = video[CAPTION + index].astype(int)
        column, row = np.round(view.pixels(match.observations["ball"][index])).astype(int)
        assert np.abs(frame[row, column] - BALL_COLOUR).max() < 60, index
        players = match.observations["left_team"][index]
        column, row = np.round(view.pixels(players[0])).astype(int)
        assert np.abs(frame[row, column] - LEFT_COLOUR).max() < 60, "the keeper is alone"
        column, row = np.round(view.pixels(np.array([-0.5, 0.2]))).astype(int)
        red, green, blue = frame[row, column]
        assert green > max(red, blue) + 25, "grass"
    controlled = match.observations["left_team"][1, match.observations["active"][1]]
    column, row = np.round(view.pixels(controlled)).astype(int)
    around = video[CAPTION + 1][row - 12 : row + 13, column - 12 : column + 13].astype(int)
    assert (np.abs(around - CONTROLLED_COLOUR).max(-1) < 90).sum() > 15

    assert watch("--replay", "goals.npz", "--width", 640, "--out", "again.mp4")[0] == 0
    np.testing.assert_array_equal(iio.imread(tmp_path / "again.mp4"), video)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"goals.mp4", "goals.npz", "again.mp4"}


@needs_engine
def test_the_same_seed_gives_the_same_gif_of_a_policy(watch, tmp_path):
    options = ["--policy", "random", "--scenario", SCENARIO, "--width", 320, "--seed", 8]
    for name in ("one.gif", "two.gif"):
        code, _, errors = watch(*options, "--out", name, "--save-replay", f"{name}.npz")
        assert (code, errors) == (0, "")
    ((match,), _) = load_replay(tmp_path / "one.gif.npz")
    assert len(set(match.actions.tolist())) > 3
    frames = iio.imread(tmp_path / "one.gif")
    assert frames.shape[0] == match.num_steps + 1 + 2 * CAPTION
    np.testing.assert_array_equal(frames, iio.imread(tmp_path / "two.gif"))


def test_where_no_match_has_a_goal_there_is_no_video(watch, tmp_path):
    save_replay(tmp_path / "draw.npz", recorded_matches()[1:])
    code, output, errors = watch("--replay", "draw.npz", "--only", "goals")
    assert (code, output) == (2, "")
    assert "None of 1 matches had a goal" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["draw.npz"]


BAD_INPUT = {
    "missing run": (["nowhere"], "no checkpoint at nowhere"),
    "no argument": ([], "Give one of RUN_OR_CHECKPOINT, --policy and --replay"),
    "too much": (["nowhere", "--policy", "idle"], "not several"),
    "scenario": (["nowhere", "--scenario", "academy_empty_gaol"], "academy_empty_goal"),
    "policy": (["--policy", "best"], "builtin-ai"),
    "policy of what": (["--policy", "idle"], "--policy needs a --scenario"),
    "view": (["nowhere", "--view", "4d"], "both"),
    "episodes": (["nowhere", "--episodes", "0"], "0 is not in [1, 1,000,000,000]"),
    "seed": (["nowhere", "--seed", "-1"], "[0, 2**32 - 1]"),
    "fps": (["nowhere", "--fps", "nan"], "[1, 100]"),
    "width": (["nowhere", "--width", "100"], "a multiple of 4 in [320, 3840]"),
    "odd width": (
        ["nowhere", "--view", "both", "--width", "642"],
        "a multiple of 4 in [640, 3840]",
    ),
    "device": (["RUN", "--device", "abacus"], "abacus"),
    "ending": (["nowhere", "--out", "match.avi"], "must end in .mp4 or .gif"),
    "directory": (["nowhere", "--out", "no/where.mp4"], "no directory no"),
    "replay's directory": (["nowhere", "--save-replay", "no/where.npz"], "no directory no"),
    "unwritable": (["nowhere", "--out", "/proc/match.mp4"], "can't be written"),
    "unwritable replay": (["nowhere", "--save-replay", "/proc/a.npz"], "/proc/a.npz can't be"),
    "one file for two": (
        ["nowhere", "--out", "a.mp4", "--save-replay", "a.mp4"],
        "give each a file of its own",
    ),
    "truncated checkpoint": (["truncated.pt"], "truncated.pt is damaged"),
    "missing replay": (["--replay", "none.npz"], "no file none.npz"),
    "damaged replay": (["--replay", "truncated.pt"], "truncated.pt holds no recorded matches"),
    "seed of a replay": (["--replay", "none.npz", "--seed", "1"], "--seed is for matches"),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_answered_with_one_line_and_exit_code_2(case, shooter, watch, tmp_path):
    arguments, expected = BAD_INPUT[case]
    whole = (shooter / "checkpoints" / "last.pt").read_bytes()
    (tmp_path / "truncated.pt").write_bytes(whole[: len(whole) // 2])
    code, output, errors = watch(*(shooter if part == "RUN" else part for part in arguments))
    assert (code, output) == (2, "")
    assert errors.startswith("fbrl-watch: error: ")
    assert errors.count("\n") == 1
    assert expected in errors
    assert [path.name for path in tmp_path.iterdir()] == ["truncated.pt"]


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ("mplsoccer", "pip install 'fbrl[analysis]'"),
        ("imageio_ffmpeg", "pip install 'fbrl[analysis]'"),
        ("fbrl_engine", "The football engine can't be imported"),
    ],
)
def test_what_is_not_installed_is_named_with_its_remedy(
    missing, expected, shooter, watch, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, missing, None)
    load_gfootball.cache_clear()
    code, output, errors = watch(shooter)
    load_gfootball.cache_clear()
    assert (code, output) == (2, "")
    assert expected in errors
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


ENDLESS = ["--policy", "idle", "--scenario", SCENARIO, "--episodes", "500", "--width", "320"]


def wait_for_the_video(directory):
    deadline = time.monotonic() + 120
    while not list(directory.glob(".fbrl-video-*/video.mp4")):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@needs_engine
def test_an_interrupted_video_leaves_nothing_behind(watch, tmp_path):
    def interrupt():
        wait_for_the_video(tmp_path)
        os.kill(os.getpid(), signal.SIGINT)

    other = threading.Thread(target=interrupt)
    other.start()
    code, _, errors = watch(*ENDLESS)
    other.join()
    assert (code, errors) == (130, "fbrl-watch: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@needs_engine
def test_a_process_that_is_to_end_tidies_up_behind_itself(tmp_path):
    program = Path(sys.executable).with_name("fbrl-watch")
    process = subprocess.Popen([program, *ENDLESS], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    wait_for_the_video(tmp_path)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=300)
    assert (process.returncode, errors) == (130, "fbrl-watch: interrupted\n")
    assert list(tmp_path.iterdir()) == []
