"""The progress that commands show where there is no terminal."""

from __future__ import annotations

import pytest

from fbrl.cli import eval_display, watch_display
from fbrl.cli.eval_display import EvaluationProgress
from fbrl.cli.progress import ProgressDisplay
from fbrl.cli.watch_display import WatchDisplay


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def test_lines_come_now_and_then_and_on_standard_error(capsys):
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        display.line("[one] of two")
    assert capsys.readouterr() == ("", "[one] of two\n")
    with ProgressDisplay(seconds_between_lines=1000.0) as display:
        display.line("one")
    assert capsys.readouterr() == ("", "")


def test_a_terminal_has_a_bar_in_their_place(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        display.line("one")
    assert "one" not in capsys.readouterr().err


def test_an_evaluation_tells_its_matches_and_steps(capsys, monkeypatch):
    monkeypatch.setattr(eval_display, "SECONDS_BETWEEN_LINES", 0.0)
    with EvaluationProgress(8) as progress:
        show = progress.of("idle in academy_corner")
        show(0)
        show(2)
    assert capsys.readouterr().err.splitlines() == [
        "idle in academy_corner, 1 steps each: 0/8 matches",
        "idle in academy_corner, 2 steps each: 2/8 matches",
    ]


def test_a_video_tells_what_is_played_and_what_is_drawn(capsys, monkeypatch):
    monkeypatch.setattr(watch_display, "SECONDS_BETWEEN_LINES", 0.0)
    with WatchDisplay() as display:
        display.playing(1, 20)
        display.drawing(2, 5, 30)
    assert capsys.readouterr().err.splitlines() == [
        "playing match 2: step 20",
        "drawing match 2: frame 5/30",
    ]
