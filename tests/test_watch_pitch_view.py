"""Recorded matches from above."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from watching import recorded_matches

from fbrl.density import AssistDensity
from fbrl.drawing.match_picture import (
    BALL_COLOUR,
    CONTROLLED_COLOUR,
    LEFT_COLOUR,
    RIGHT_COLOUR,
)
from fbrl.watch.pitch_view import PitchView


@pytest.fixture(scope="module")
def drawn():
    """A view without densities, a match, and its frames."""
    view = PitchView(None, width=640)
    recording = recorded_matches()[0]
    return view, recording, list(view.frames(recording))


def colour_at(view, frame, position):
    column, row = np.round(view.pixels(np.asarray(position))).astype(int)
    return frame[row, column].astype(int)


def near(colour, expected, tolerance=40):
    return bool((np.abs(np.asarray(colour) - expected) <= tolerance).all())


def test_there_is_a_frame_for_every_state(drawn):
    view, recording, frames = drawn
    assert len(frames) == recording.num_steps + 1
    assert {(frame.shape, str(frame.dtype)) for frame in frames} == {
        ((view.height, view.width, 3), "uint8")
    }
    assert view.width == 640
    assert view.height % 2 == 0


def test_the_pitch_has_its_real_proportions(drawn):
    view, _, frames = drawn
    corners = view.pixels(np.array([[-1.0, -0.42], [1.0, 0.42]]))
    length, width = corners[1] - corners[0]
    assert length / width == pytest.approx((2 * 54.4) / (0.84 * 83.6))
    # The touch lines and the goal lines are where the environment has them.
    for x, y in ((0.0, -0.42), (-0.5, 0.42), (-1.0, 0.3), (1.0, -0.3)):
        column, row = np.round(view.pixels(np.array([x, y]))).astype(int)
        around = frames[0][row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3)
        assert around.min(axis=-1).max() > 170, f"a white line at {x}, {y}"
    red, green, blue = colour_at(view, frames[0], (-0.4, 0.3))
    assert green > red + 30
    assert green > blue + 30


def test_players_and_ball_are_drawn_where_they_are(drawn):
    view, recording, frames = drawn
    observations = recording.observations
    seen = 0
    for index in (0, 8, 16, 30):
        ball = observations["ball"][index, :2]
        assert near(colour_at(view, frames[index], ball), BALL_COLOUR), index
        drawn_later = [ball]
        for team, colour in (("left_team", LEFT_COLOUR), ("right_team", RIGHT_COLOUR)):
            positions = observations[team][index][observations[f"{team}_roles"][index] != -1]
            for player, position in enumerate(positions):
                others = [*drawn_later, *(p for p in positions[player + 1 :])]
                if team == "right_team":
                    others += list(observations["left_team"][index])
                if min(np.hypot(*(p - position)) for p in others) > 0.06:
                    assert near(colour_at(view, frames[index], position), colour), (index, player)
                    seen += 1
    assert seen > 12


def test_the_controlled_player_is_marked(drawn):
    view, recording, frames = drawn
    index = 12
    observations = recording.observations
    marks = 0
    for player in range(4):
        column, row = view.pixels(observations["left_team"][index, player])
        ring = [
            frames[index][round(row + r * np.sin(angle)), round(column + r * np.cos(angle))]
            for r in np.arange(7.0, 13.0, 0.5)
            for angle in np.linspace(0, 2 * np.pi, 12)
        ]
        marked = sum(near(colour, CONTROLLED_COLOUR) for colour in ring) > 12
        assert marked == (player == observations["active"][index])
        marks += marked
    assert marks == 1


def test_the_ball_leaves_a_trail_that_ends_where_it_is_put_back(drawn):
    view, recording, frames = drawn
    ball = recording.observations["ball"][:, :2]
    # In flight, on the way to the goal.
    assert near(colour_at(view, frames[-2], ball[-4]), BALL_COLOUR, 110)
    grass = colour_at(view, frames[0], ball[-4])
    assert not near(grass, BALL_COLOUR, 110)
    # After the goal it lies on the kick-off spot.
    assert np.hypot(*(ball[-1] - ball[-2])) > 0.8
    between = 0.7 * ball[-1] + 0.3 * ball[-2]
    np.testing.assert_array_equal(
        colour_at(view, frames[-1], between), colour_at(view, frames[0], between)
    )


def test_the_density_lies_on_the_grass_where_it_is_high(drawn):
    plain, recording, frames = drawn
    view = PitchView(AssistDensity.default(), width=640)
    frame = next(view.frames(recording))
    assert not near(colour_at(view, frame, (0.8, 0.05)), colour_at(plain, frames[0], (0.8, 0.05)))
    far = (-0.8, 0.3)
    assert near(colour_at(view, frame, far), colour_at(plain, frames[0], far), 12)


def test_the_reward_strip_fills_up(drawn):
    _, _, frames = drawn
    strip = [frame[-round(128 * 640 / 960) :] for frame in frames]
    coloured = [
        int((part.max(axis=-1).astype(int) - part.min(axis=-1) > 90).sum()) for part in strip
    ]
    assert coloured[-1] > coloured[len(coloured) // 2] > coloured[0]


def test_the_same_recording_gives_the_same_frames(drawn):
    _, recording, frames = drawn
    other = PitchView(None, width=640)
    for frame, again in zip(frames, other.frames(recording), strict=True):
        np.testing.assert_array_equal(frame, again)


def test_one_view_draws_matches_of_any_reward():
    view = PitchView(None, width=320)
    recording = recorded_matches()[0]
    scoring = {"reward_scoring": recording.rewards["reward_scoring"]}
    for rewards in (scoring, {**scoring, "reward_checkpoint": -scoring["reward_scoring"]}):
        frames = list(view.frames(dataclasses.replace(recording, rewards=rewards)))
        assert {frame.shape for frame in frames} == {(view.height, 320, 3)}


@pytest.mark.parametrize("width", [318, 641])
def test_a_width_that_no_video_can_have_is_refused(width):
    with pytest.raises(ValueError, match=f"width is {width}; an even number of at least 320"):
        PitchView(None, width=width)
