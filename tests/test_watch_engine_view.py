"""Recorded matches as the engine draws them, in a process of its own."""

from __future__ import annotations

import dataclasses
import os
import time

import numpy as np
import psutil
import pytest
from watching import recorded_matches

from fbrl.envs import engine_pictures
from fbrl.envs.engine_pictures import RenderingError
from fbrl.watch.engine_view import EngineView
from fbrl.watch.pitch_view import PitchView
from fbrl.watch.views import open_view


def shortened(recording, steps):
    """The first steps of a match."""
    return dataclasses.replace(
        recording,
        actions=recording.actions[:steps],
        observations={key: array[: steps + 1] for key, array in recording.observations.items()},
        rewards={key: array[:steps] for key, array in recording.rewards.items()},
    )


def rendering_processes():
    """Those that this process has started; other tests leave helpers of multiprocessing behind."""
    alive = [p for p in psutil.Process().children() if p.status() != psutil.STATUS_ZOMBIE]
    return [p for p in alive if "fbrl.envs.render_process" in p.cmdline()]


def test_matches_are_drawn_from_above_and_by_the_engine_in_step():
    first, second = recorded_matches()
    with open_view("both", 640, None) as view:
        # When the last frame is there, every position of the whole match has been compared.
        both = list(view.frames(first))
        (process,) = rendering_processes()
        again = list(view.frames(shortened(first, 1)))
        other = next(iter(list(view.frames(shortened(second, 1)))))
        assert rendering_processes() == [process]

        moved = {**second.observations, "ball": second.observations["ball"].copy()}
        moved["ball"][2, 0] += 1e-6
        with pytest.raises(RenderingError, match="at step 2 the positions differ"):
            list(view.frames(dataclasses.replace(second, observations=moved)))
    assert rendering_processes() == []

    above = list(PitchView(None, 320).frames(first))
    assert len(both) == len(above) == first.num_steps + 1
    for frame, expected in zip(both, above, strict=True):
        np.testing.assert_array_equal(frame[:, :320], expected)
    drawn = [frame[:, 320:] for frame in both]
    assert {(frame.shape, str(frame.dtype)) for frame in drawn} == {(above[0].shape, "uint8")}
    for frame in (drawn[0], drawn[10], drawn[-1]):
        red, green, blue = frame.reshape(-1, 3).mean(0)
        assert green > red + 8 > 20, "mostly grass, neither black nor sky"
        assert green > blue + 8
    assert np.abs(drawn[0].astype(int) - drawn[20]).mean() > 1, "the players move"
    for frame, same in zip(both, again, strict=False):
        np.testing.assert_array_equal(frame[:, 320:], same[:, 320:])
    assert (drawn[0] != other[:, 320:]).any()


@pytest.mark.parametrize(
    ("ending", "reason"),
    [
        ("os.kill(os.getpid(), 11)", "ended with SIGSEGV"),
        ("os.write(2, b'no libEGL here'); os._exit(3)", "ended with exit code 3: no libEGL here"),
    ],
)
def test_a_process_that_dies_is_an_error_with_its_reason(tmp_path, monkeypatch, ending, reason):
    # Python runs this file when it starts: an installation whose rendering is broken.
    (tmp_path / "sitecustomize.py").write_text(f"import os\n{ending}\n")
    inherited = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(tmp_path), inherited])))
    with EngineView(160, 90) as view, pytest.raises(RenderingError) as caught:
        next(view.frames(recorded_matches()[0]))
    assert reason in str(caught.value)
    assert "libgl1-mesa-dri" in str(caught.value)


def test_a_process_that_draws_nothing_is_not_waited_for_without_end(monkeypatch):
    monkeypatch.setattr(engine_pictures, "SECONDS_OF_PATIENCE", 0.05)
    started = time.monotonic()
    with (
        EngineView(160, 90) as view,
        pytest.raises(RenderingError, match=r"drawn nothing for 0\.05 s"),
    ):
        next(view.frames(recorded_matches()[0]))
    assert time.monotonic() - started < 5
    assert rendering_processes() == []
