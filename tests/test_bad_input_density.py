"""Wrong input to densities, their fit and their controls: one clear error each."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from fbrl.density import AssistDensity, PositionDensity, open_density, pitch_from_statsbomb
from fbrl.density.controls import mirrored, shuffled, uniform
from fbrl.density.filters import PassFilter
from fbrl.density.fit import fit_assist_density, fit_position_density
from fbrl.density.pass_cache import PassCache
from fbrl.density.passes import Pass, passes_of_match

POINTS = np.random.default_rng(0).normal(0, 0.1, (50, 2))
DEFAULT = AssistDensity.default()
ONES = torch.ones(2, 2)


@pytest.mark.parametrize(
    ("grid", "peak", "error", "message"),
    [
        (None, 1.0, TypeError, "grid is a NoneType"),
        (np.ones((3, 3)), 1.0, TypeError, "grid is a ndarray"),
        (torch.ones(2, 2).long(), 1.0, TypeError, "dtype torch.int64"),
        (ONES, "1", TypeError, "peak is '1'; it must be a number"),
        (ONES, True, TypeError, "peak is True"),
        (ONES, None, TypeError, "peak is None"),
        (ONES, math.nan, ValueError, "peak is nan; it must be a positive, finite number"),
        (ONES, 10**400, ValueError, "positive, finite number"),
        (torch.full((2, 2), math.nan), 1.0, ValueError, "every node must be finite"),
    ],
)
def test_a_surface_that_there_is_not_is_refused(grid, peak, error, message):
    with pytest.raises(error, match=message):
        PositionDensity(grid, peak)


@pytest.mark.parametrize(
    ("position", "error", "message"),
    [
        ([0.0, 0.0], TypeError, "position is list; expected a floating-point tensor"),
        (np.zeros(2), TypeError, "expected a floating-point tensor"),
        (None, TypeError, "position is NoneType"),
        (torch.zeros(2).long(), TypeError, "position is torch.int64"),
        (torch.zeros(3), ValueError, r"position has shape \(3,\); expected \(..., 2\)"),
        (torch.zeros(4, 1), ValueError, r"shape \(4, 1\)"),
        (torch.tensor(0.0), ValueError, r"shape \(\)"),
    ],
)
def test_what_is_no_position_has_no_density(position, error, message):
    with pytest.raises(error, match=message):
        DEFAULT.end(position)


@pytest.mark.parametrize("name", [None, 5, b"uniform", ["uniform"]])
def test_what_is_neither_a_name_nor_a_path_opens_nothing(name):
    with pytest.raises(TypeError, match=r"The density is .*; expected a path, or one of default"):
        open_density(name)
    with pytest.raises(TypeError, match="expected the path of a density file"):
        AssistDensity.load(name)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AssistDensity(None, None), "start is a NoneType; expected a PositionDensity"),
        (lambda: AssistDensity(DEFAULT.start, torch.nn.Identity()), "end is a Identity"),
        (
            lambda: AssistDensity(DEFAULT.start, DEFAULT.end, {}),
            "metadata is a dict; expected Dens",
        ),
        (
            lambda: dataclasses.replace(DEFAULT.metadata, n="474"),
            "n is '474'; it must be",
        ),
        (lambda: dataclasses.replace(DEFAULT.metadata, n=True), "n is True"),
        (lambda: dataclasses.replace(DEFAULT.metadata, counts={"a": None}), "counts is"),
        (lambda: uniform(None), "density is a NoneType; expected an AssistDensity"),
        (lambda: mirrored(5), "density is a int"),
        (lambda: shuffled("default"), "density is a str"),
    ],
)
def test_parts_of_another_type_are_refused(make, message):
    with pytest.raises(TypeError, match=message):
        make()


def test_a_mean_over_positions_where_nothing_is_paid_is_refused():
    for positions in (torch.zeros(0, 2), torch.full((3, 2), 9.0)):
        with pytest.raises(ValueError, match="mean over the positions is not above 0"):
            uniform(DEFAULT, positions)


@pytest.mark.parametrize(
    ("points", "options", "error", "message"),
    [
        ("abc", {}, ValueError, "points are no array of numbers"),
        ([[1.0], [1.0, 2.0]], {}, ValueError, "no array of numbers"),
        (None, {}, ValueError, r"points .*shape \(\)|no array"),
        (POINTS, {"bandwidth": True}, ValueError, "bandwidth is True"),
        (POINTS, {"bandwidth": 1e300}, ValueError, "or a number from 1e-06 to 1000"),
        (POINTS, {"bandwidth": [1]}, ValueError, r"bandwidth is \[1\]"),
        (POINTS, {"columns": "a"}, TypeError, "columns is 'a'"),
        (POINTS, {"columns": 21.0}, TypeError, "columns is 21.0"),
        (POINTS, {"peak": "a"}, TypeError, "peak is 'a'"),
    ],
)
def test_a_fit_that_there_is_not_is_refused(points, options, error, message):
    with pytest.raises(error, match=message):
        fit_position_density(points, **{"peak": 0.1, "columns": 21, **options})


def test_starts_without_ends_are_refused():
    for starts in (None, 5, POINTS[:20]):
        with pytest.raises(ValueError, match="starts"):
            fit_assist_density(starts, POINTS, source="", filter="", columns=21)
    with pytest.raises(ValueError, match="points are no array of numbers"):
        pitch_from_statsbomb([["a", "b"]])


@pytest.mark.parametrize("bound", ["a", math.nan, -1.0, 121.0])
def test_a_filter_beyond_the_pitch_is_refused(bound):
    with pytest.raises(ValueError, match=r"min_end_x is .*; it must be in \[0, 120\]"):
        PassFilter(min_end_x=bound)


def event(**changes):
    details = {"goal_assist": True, "end_location": [100.0, 40.0]}
    made = {"type": {"name": "Pass"}, "pass": details, "location": [90.0, 40.0]}
    return {**made, "play_pattern": {"name": "Regular Play"}, **changes}


@pytest.mark.parametrize(
    "changed",
    [
        None,
        {},
        event(location=[1]),
        event(location=[10**400, 1]),
        event(location=["a", "b"]),
        event(play_pattern={"name": 5}),
        event(play_pattern=None),
        event(type="Pass"),
    ],
)
def test_an_event_in_another_layout_is_refused_with_its_match(changed):
    with pytest.raises(ValueError, match="Match 7: an event is not in StatsBomb's layout"):
        passes_of_match([event(), changed], 7)


@pytest.mark.parametrize("content", ["[" * 5000, "1" * 5000, '{"format": 1, "rows": [[]]}', "{}"])
def test_a_damaged_file_of_the_cache_counts_as_absent(tmp_path: Path, content):
    cache = PassCache(tmp_path)
    cache.keep_passes(7, [Pass(1.0, 2.0, 3.0, 4.0)])
    assert cache.passes(7) == [Pass(1.0, 2.0, 3.0, 4.0)]
    tmp_path.joinpath("match-7.json").write_text(content)
    assert cache.passes(7) is None
    cache.keep_passes(7, [Pass("1", 2.0, 3.0, 4.0)])
    assert cache.passes(7) is None
