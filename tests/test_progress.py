"""The progress that commands show where there is no terminal."""

from __future__ import annotations

import pytest

from fbrl.cli.eval import matches_shown
from fbrl.cli.outputs import ProgressDisplay


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def test_lines_come_now_and_then_and_on_standard_error(capsys):
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        display.show("[one]", 1, 2, "[matches]")
    assert capsys.readouterr() == ("", "[one]: 1/2 [matches]\n")
    with ProgressDisplay(seconds_between_lines=1000.0) as display:
        display.show("one", 1, 2, "matches")
    assert capsys.readouterr() == ("", "")


def test_a_terminal_has_a_bar_in_their_place(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        display.show("one", 1, 2, "matches")
    assert "one: " not in capsys.readouterr().err


def test_an_evaluation_tells_its_matches_and_steps(capsys):
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        show = matches_shown(display, "idle in academy_corner", 8)
        show(0)
        show(2)
    assert capsys.readouterr().err.splitlines() == [
        "idle in academy_corner: 0/8 matches, 1 steps each",
        "idle in academy_corner: 2/8 matches, 2 steps each",
    ]


def test_a_video_tells_what_is_played_and_what_is_drawn(capsys):
    with ProgressDisplay(seconds_between_lines=0.0) as display:
        display.show("playing match 2", 20, None, "steps")
        display.show("drawing match 2", 5, 30, "frames")
    assert capsys.readouterr().err.splitlines() == [
        "playing match 2: 20 steps",
        "drawing match 2: 5/30 frames",
    ]
