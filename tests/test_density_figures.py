"""Pictures: what is drawn where, and the files."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

pytest.importorskip("mplsoccer")
from matplotlib.colors import to_hex
from matplotlib.image import imread

from fbrl.checks import MissingExtraError
from fbrl.density import AssistDensity, PositionDensity
from fbrl.density.passes import Pass
from fbrl.figures.files import save_figure
from fbrl.figures.pitch import agent_figure, densities_figure, passes_figure

PASSES = [Pass(90, 10, 110, 40), Pass(60, 70, 100, 30)]


def painted(axes):
    (image,) = axes.images
    assert tuple(image.get_extent()) == (0, 120, 80, 0)  # the first row is the top touch line
    return np.asarray(image.get_array())


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_passes_go_by_yellow_lines_from_red_starts_to_blue_ends():
    axes = passes_figure(PASSES, "two passes").axes[0]
    starts, ends = axes.collections[-2:]
    np.testing.assert_array_equal(starts.get_offsets(), [[90, 10], [60, 70]])
    np.testing.assert_array_equal(ends.get_offsets(), [[110, 40], [100, 30]])
    red, _, blue = starts.get_facecolor()[0][:3]
    assert red > 0.7 > blue
    red, _, blue = ends.get_facecolor()[0][:3]
    assert blue > 0.7 > red
    lines = [line for line in axes.lines if to_hex(line.get_color()) == "#ffe34d"]
    paths = [np.transpose(line.get_data()).tolist() for line in lines]
    assert paths == [[[90, 10], [110, 40]], [[60, 70], [100, 30]]]


def test_densities_are_painted_where_they_are():
    grid = torch.zeros(5, 3)
    grid[4, 0] = 1.0  # the attacked corner at the top: x = 1, y = -0.42
    surface = PositionDensity(grid, peak=0.1)
    figure = densities_figure(AssistDensity(PositionDensity(torch.ones(5, 3), 0.001), surface))
    start, end = figure.axes[:2]
    np.testing.assert_allclose(painted(start), 0.001)
    assert np.argwhere(painted(end)).tolist() == [[0, 4]]
    assert painted(end)[0, 4] == pytest.approx(0.1)


def test_the_agents_share_of_its_time_is_painted_next_to_the_densities():
    positions = [[0.99, -0.41]] * 3 + [[-0.99, 0.41]]
    figure = agent_figure(positions, AssistDensity.default(), "an agent")
    share = painted(figure.axes[0])
    assert share[0, -1] == 75
    assert share[-1, 0] == 25
    assert share.sum() == 100
    assert [axes.get_title() for axes in figure.axes[:3]] == [
        "an agent",
        "Paid for having the ball",
        "Paid for receiving a pass",
    ]


def test_the_owner_of_the_data_is_credited():
    shipped = AssistDensity.default()
    assert "Data: StatsBomb" in texts(passes_figure(PASSES, "", "Data: StatsBomb"))
    assert "Data: StatsBomb" in texts(densities_figure(shipped))
    assert "Data: StatsBomb" in texts(agent_figure([[0, 0]], shipped, ""))


def test_the_same_picture_is_the_same_file(tmp_path):
    for name in ("a.png", "a.svg"):
        contents = []
        for _ in range(2):
            save_figure(passes_figure(PASSES, "two passes"), tmp_path / name)
            contents.append((tmp_path / name).read_bytes())
        assert contents[0] == contents[1]
    assert imread(tmp_path / "a.png").shape[1] > 1000
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")


def test_another_kind_of_picture_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.pdf: a picture's name must end in \.png or \.svg"):
        save_figure(passes_figure(PASSES, ""), tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())


def test_without_mplsoccer_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mplsoccer", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'fbrl\[density\]'"):
        densities_figure(AssistDensity.default())
