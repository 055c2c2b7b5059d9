"""Densities: the exact kernel sum, the bandwidth rules, the grid, the file and the shipped pair."""

from __future__ import annotations

import dataclasses
import doctest
import importlib
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from reward_oracle import bandwidth, kernel_density
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import gaussian_kde

from fbrl.cli.density import main
from fbrl.density import AssistDensity, DensityMetadata, PositionDensity, pitch_from_statsbomb
from fbrl.density.fit import fit_assist_density, fit_position_density
from fbrl.density.kde import (
    check_points,
    equivalent_bandwidth,
    grid_positions,
    kernel_covariance,
    kernel_sum,
)
from fbrl.density.passes import starts_and_ends
from fbrl.density.tables import read_passes_csv

ASSISTS = Path(__file__).parents[2] / "shared" / "data" / "open_play_assists.csv"
needs_data = pytest.mark.skipif(not ASSISTS.exists(), reason="the StatsBomb table is not here")

METADATA = DensityMetadata("made up", "none", 60, "thesis", 0.1, 0.2, 0.001, "nobody")


def made_up_points(n: int = 60, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    points = random.normal([0.5, 0.05], [0.25, 0.15], (n, 2))
    return np.clip(points, [-1, -0.42], [1, 0.42])


def made_up_density() -> AssistDensity:
    random = np.random.default_rng(0)
    grids = [torch.from_numpy(random.random((5, 4)).astype(np.float32)) for _ in range(2)]
    return AssistDensity(PositionDensity(grids[0], 0.001), PositionDensity(grids[1], 0.1), METADATA)


@pytest.mark.parametrize(
    "name", ["coordinates", "position", "assist", "fit", "filters", "controls"]
)
def test_the_docstrings_examples_run(name):
    result = doctest.testmod(importlib.import_module(f"fbrl.density.{name}"))
    assert result.failed == 0
    assert result.attempted > 0


class TestKernelSum:
    def test_is_equation_4_1(self):
        points = made_up_points()
        h = bandwidth(points)
        queries = np.random.default_rng(1).uniform([-1, -0.42], [1, 0.42], (50, 2))
        ours = kernel_sum(points, queries, kernel_covariance(points, "thesis"))
        theirs = [kernel_density(points, h, x, y) for x, y in queries]
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)

    @pytest.mark.parametrize("rule", ["silverman", "scott"])
    def test_is_scipys_with_scipys_rules(self, rule):
        points = made_up_points()
        queries = grid_positions(9, 5)
        ours = kernel_sum(points, queries, kernel_covariance(points, f"scipy-{rule}"))
        theirs = gaussian_kde(points.T, bw_method=rule)(queries.reshape(-1, 2).T)
        np.testing.assert_allclose(ours, theirs.reshape(9, 5), rtol=1e-9)

    def test_a_number_is_the_bandwidth(self):
        covariance = kernel_covariance(made_up_points(), 0.05)
        np.testing.assert_allclose(covariance, [[0.0025, 0], [0, 0.0025]])
        assert equivalent_bandwidth(covariance) == pytest.approx(0.05)

    def test_a_number_in_metres_is_round_in_metres(self):
        covariance = kernel_covariance(made_up_points(), 4.0, metres=True)
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)) * [54.4, 83.6], [4.0, 4.0])
        assert covariance[0, 1] == 0

    def test_the_thesis_rule_in_metres_is_equation_4_2_in_metres(self):
        points = made_up_points()
        covariance = kernel_covariance(points, "thesis", metres=True)
        h = bandwidth(points * [54.4, 83.6])
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [h / 54.4, h / 83.6])

    @pytest.mark.parametrize("rule", ["scipy-silverman", "scipy-scott"])
    def test_scipys_kernels_are_the_same_in_metres(self, rule):
        points = made_up_points()
        np.testing.assert_allclose(
            kernel_covariance(points, rule, metres=True), kernel_covariance(points, rule)
        )

    def test_many_queries_give_the_same_in_blocks(self):
        points, covariance = made_up_points(12), 0.01 * np.eye(2)
        queries = np.random.default_rng(0).uniform(-0.4, 0.4, (5000, 2))
        whole = kernel_sum(points, queries, covariance)
        np.testing.assert_allclose(whole[4999], kernel_sum(points, queries[4999], covariance))

    @pytest.mark.parametrize("bad", ["thesys", 0, -0.1, float("nan"), float("inf"), None])
    def test_another_bandwidth_is_refused(self, bad):
        with pytest.raises(
            ValueError, match=r"bandwidth is .*scipy-silverman.*number from 1e-06 to 1000"
        ):
            kernel_covariance(made_up_points(), bad)


class TestPoints:
    @pytest.mark.parametrize(
        ("points", "message"),
        [
            (made_up_points(9), "9 points; a density needs at least 10"),
            (np.zeros((12, 3)), r"shape \(12, 3\); expected \(n, 2\)"),
            (np.r_[made_up_points(), [[np.nan, 0]]], r"starts\[60\] is \[nan, 0.0\]: not a finite"),
            (np.r_[made_up_points(), [[0, 0.43]]], r"starts\[60\].*outside the pitch"),
            (np.r_[made_up_points(), [[96.0, 40.0]]], "pitch_from_statsbomb"),
            (made_up_points() * [1, 0], "zero variance in y"),
        ],
    )
    def test_points_that_make_no_density_are_refused(self, points, message):
        with pytest.raises(ValueError, match=message):
            check_points(points, "starts")

    def test_points_on_the_lines_are_accepted(self):
        corners = pitch_from_statsbomb([[0, 0], [120, 80], [120, 0], [0, 80]] * 3)
        assert len(check_points(corners)) == 12

    def test_statsbombs_pitch_becomes_ours(self):
        ours = pitch_from_statsbomb([[[120, 40], [60, 0]], [[0, 80], [90, 20]]])
        expected = [[[1, 0], [0, -0.42]], [[-1, 0.42], [0.5, -0.21]]]
        np.testing.assert_allclose(ours, expected, atol=1e-15)


class TestPositionDensity:
    @settings(deadline=None, max_examples=200)
    @given(data=st.data())
    def test_interpolates_bilinearly_and_is_zero_elsewhere(self, data):
        columns, rows = data.draw(st.integers(2, 9)), data.draw(st.integers(2, 9))
        seed = data.draw(st.integers(0, 2**16))
        grid = np.random.default_rng(seed).random((columns, rows)) + 1e-3
        density = PositionDensity(torch.from_numpy(grid), peak=0.1)
        coordinate = st.sampled_from([-1.0, 1.0, 0.42, -0.42]) | st.floats(-1.5, 1.5)
        points = np.array(data.draw(st.lists(st.tuples(coordinate, coordinate), max_size=8)))
        points = points.reshape(-1, 2)
        axes = (np.linspace(-1, 1, columns), np.linspace(-0.42, 0.42, rows))
        reference = RegularGridInterpolator(axes, grid, bounds_error=False, fill_value=0.0)
        expected = 0.1 * reference(points) / grid.max()
        ours = density(torch.from_numpy(points)).numpy()
        # Within a hair of the lines either answer is right; there the reference alone says 0.
        sure = (np.abs(np.abs(points) - [1, 0.42]) > 1e-5).all(-1) | (expected > 0)
        np.testing.assert_allclose(ours[sure], expected[sure], atol=1e-6)

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_the_lines_belong_to_the_pitch(self, dtype):
        density = PositionDensity(torch.ones(80, 35, dtype=torch.float32), peak=0.1)
        lines = torch.tensor([[1, 0.42], [-1, -0.42], [1, -0.42], [-1, 0.42]], dtype=dtype)
        torch.testing.assert_close(density(lines), torch.full((4,), 0.1, dtype=dtype))
        assert not density(lines * 1.001).any()

    @given(st.lists(st.tuples(st.floats(width=32), st.floats(width=32)), min_size=1, max_size=20))
    @settings(deadline=None)
    def test_values_stay_within_zero_and_the_peak(self, points):
        density = AssistDensity.default().end
        value = density(torch.tensor(points, dtype=torch.float32))
        assert ((value >= 0) & (value <= density.peak)).all()

    @pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e30])
    def test_a_position_that_is_nowhere_has_no_density(self, bad):
        density = PositionDensity(torch.ones(4, 4))
        nowhere = torch.tensor([[bad, 0.0], [0.0, bad], [bad, bad], [0.0, 0.0]])
        assert density(nowhere).tolist() == [0, 0, 0, 1]

    @pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,), (2, 0, 4)])
    def test_keeps_the_batch_shape(self, shape):
        density = PositionDensity(torch.ones(4, 4), peak=2.0)
        assert density(torch.zeros(*shape, 2)).shape == shape
        assert (density(torch.zeros(*shape, 2)) == 2.0).all()

    def test_the_grid_is_normalised_and_kept(self):
        grid = torch.rand(7, 5) + 0.1
        density = PositionDensity(3 * grid, peak=0.01)
        torch.testing.assert_close(density.grid, grid / grid.max())
        nodes = torch.from_numpy(grid_positions(7, 5))
        torch.testing.assert_close(
            density(nodes), (0.01 * grid / grid.max()).double(), atol=1e-7, rtol=0
        )

    def test_the_first_index_runs_along_x(self):
        grid = torch.zeros(3, 3)
        grid[2, 0] = 1.0
        density = PositionDensity(grid)
        corner = torch.tensor([[1.0, -0.42], [-1.0, 0.42], [1.0, 0.42]])
        torch.testing.assert_close(density(corner), torch.tensor([1.0, 0, 0]), atol=1e-4, rtol=0)

    def test_compiles_without_a_break_and_maps(self):
        density = PositionDensity(torch.rand(6, 5))
        points = torch.rand(10, 2) - 0.5
        compiled = torch.compile(density, backend="eager", fullgraph=True)
        torch.testing.assert_close(compiled(points), density(points))
        torch.testing.assert_close(torch.vmap(density)(points), density(points))

    def test_moves_to_double_precision(self):
        density = PositionDensity(torch.rand(6, 5), peak=0.1)
        points = torch.rand(10, 2, dtype=torch.float64) - 0.5
        before = density(points)
        after = density.double()(points)
        assert before.dtype == after.dtype == torch.float64
        torch.testing.assert_close(after, before, atol=1e-6, rtol=1e-6)

    def test_state_dict_restores_the_surface_and_its_peak(self):
        density = PositionDensity(torch.rand(6, 5), peak=0.1)
        other = PositionDensity(torch.rand(6, 5), peak=3.0)
        other.load_state_dict(density.state_dict())
        torch.testing.assert_close(other.grid, density.grid)
        positions = torch.rand(20, 2) * 0.4
        assert torch.equal(other(positions), density(positions))
        assert other.peak == 0.1

    def test_a_state_of_a_grid_of_another_shape_is_refused(self):
        with pytest.raises(ValueError, match="a grid with 5 rows, and this density has 6"):
            PositionDensity(torch.rand(5, 6)).load_state_dict(
                PositionDensity(torch.rand(6, 5)).state_dict()
            )

    def test_all_buffers_are_where_the_grid_is_whatever_the_default_device(self):
        grid = torch.rand(6, 5)
        with torch.device("meta"):
            density = PositionDensity(grid)
        assert {buffer.device.type for buffer in density.buffers()} == {"cpu"}

    @pytest.mark.parametrize(
        ("grid", "message"),
        [
            (torch.ones(4), r"shape \(4,\); expected \(columns, rows\)"),
            (torch.ones(1, 4), r"shape \(1, 4\)"),
            (torch.tensor([[1.0, float("nan")], [0, 0]]), "NaN or infinite"),
            (torch.tensor([[1.0, -0.5], [0, 0]]), r"negative value \(-0.5\)"),
            (torch.zeros(3, 3), "all zero"),
        ],
    )
    def test_a_grid_that_is_no_density_is_refused(self, grid, message):
        with pytest.raises(ValueError, match=message):
            PositionDensity(grid)

    @pytest.mark.parametrize("peak", [0.0, -1.0, float("nan"), float("inf")])
    def test_another_peak_is_refused(self, peak):
        with pytest.raises(ValueError, match="peak is"):
            PositionDensity(torch.ones(2, 2), peak)


class TestFit:
    @pytest.mark.parametrize("rule", ["thesis", "scipy-silverman", "scipy-scott", 0.08])
    def test_the_grid_is_within_half_a_percent_of_the_exact_sum(self, rule):
        points = made_up_points()
        fitted = fit_position_density(points, peak=0.1, bandwidth=rule)
        queries = np.random.default_rng(2).uniform([-1, -0.42], [1, 0.42], (3000, 2))
        covariance = kernel_covariance(points, rule)
        nodes = grid_positions(*fitted.density.grid.shape)
        highest = kernel_sum(points, nodes, covariance).max()
        exact = 0.1 * kernel_sum(points, queries, covariance) / highest
        error = np.abs(fitted.density(torch.from_numpy(queries)).numpy() - exact).max() / 0.1
        assert error <= fitted.max_interpolation_error * 1.01 <= 0.00505

    def test_a_coarse_grid_reports_its_error(self):
        fitted = fit_position_density(made_up_points(), peak=1.0, columns=9)
        assert fitted.density.grid.shape == (9, 4)
        assert fitted.max_interpolation_error > 0.02

    @pytest.mark.parametrize("columns", [-1, 0, 2, 1002])
    def test_a_grid_of_another_size_is_refused(self, columns):
        with pytest.raises(ValueError, match=f"columns is {columns}; it must be from 3 to 1001"):
            fit_position_density(made_up_points(), peak=1.0, columns=columns)

    @pytest.mark.parametrize("rule", ["thesis", "scipy-silverman"])
    def test_a_mirrored_fit_is_the_sum_over_the_mirror_images_too(self, rule):
        points = made_up_points()
        fitted = fit_position_density(points, peak=1.0, bandwidth=rule, mirror=True, columns=41)
        covariance = kernel_covariance(points, rule)
        nodes = grid_positions(*fitted.density.grid.shape)
        images = kernel_sum(points * [1, -1], nodes, covariance * [[1, -1], [-1, 1]])
        expected = kernel_sum(points, nodes, covariance) + images
        grid = fitted.density.grid.numpy()
        np.testing.assert_allclose(grid, expected / expected.max(), atol=1e-6)
        np.testing.assert_allclose(grid, grid[:, ::-1], atol=1e-6)
        assert fitted.bandwidth == fit_position_density(points, peak=1, bandwidth=rule).bandwidth

    def test_a_bandwidth_too_narrow_for_a_grid_is_refused(self):
        with pytest.raises(ValueError, match=r"too narrow for a grid.*wider bandwidth"):
            fit_position_density(made_up_points(), peak=1.0, bandwidth=0.001)

    def test_starts_and_ends_belong_together(self):
        with pytest.raises(ValueError, match="60 starts but 59 ends"):
            fit_assist_density(made_up_points(60), made_up_points(59), source="", filter="")


class TestFile:
    def test_what_is_saved_is_loaded(self, tmp_path):
        density = made_up_density()
        density.save(tmp_path / "a.npz")
        loaded = AssistDensity.load(tmp_path / "a.npz")
        assert loaded.metadata == METADATA
        assert (loaded.start.peak, loaded.end.peak) == (0.001, 0.1)
        assert torch.equal(loaded.start.grid, density.start.grid)
        assert torch.equal(loaded.end.grid, density.end.grid)
        loaded.save(tmp_path / "b.npz")
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()

    def test_a_file_without_the_newer_fields_is_read(self, tmp_path):
        path = tmp_path / "a.npz"
        made_up_density().save(path)
        with np.load(path) as archive:
            entries = dict(archive)
        header = json.loads(str(entries["metadata"]))
        for field in ("counts", "metres", "mirror"):
            del header[field]
        np.savez(path, **{**entries, "metadata": np.array(json.dumps(header))})
        assert AssistDensity.load(path).metadata == METADATA

    def test_a_file_that_cannot_be_written_leaves_the_old_one(self, tmp_path, monkeypatch):
        path = tmp_path / "a.npz"
        made_up_density().save(path)
        before = path.read_bytes()

        def full_disk(file, **arrays):
            file.write(b"half")
            raise OSError("No space left on device")

        monkeypatch.setattr(np, "savez_compressed", full_disk)
        with pytest.raises(OSError, match="No space"):
            made_up_density().save(path)
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]

    def test_without_metadata_nothing_is_saved(self, tmp_path):
        density = made_up_density()
        nameless = AssistDensity(density.start, density.end)
        with pytest.raises(ValueError, match="no metadata"):
            nameless.save(tmp_path / "a.npz")
        assert not (tmp_path / "a.npz").exists()

    def test_a_missing_file_is_named(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"nowhere\.npz.*fbrl-density fit"):
            AssistDensity.load(tmp_path / "nowhere.npz")

    @pytest.mark.parametrize("keep", [0, 1, 10, 100, 0.5, 0.99])
    def test_a_truncated_file_is_named(self, tmp_path, keep):
        path = tmp_path / "a.npz"
        made_up_density().save(path)
        content = path.read_bytes()
        path.write_bytes(content[: int(keep * len(content)) if keep < 1 and keep else int(keep)])
        with pytest.raises(ValueError, match=r"a\.npz is not a readable density file"):
            AssistDensity.load(path)

    def test_a_damaged_file_is_named_wherever_it_is_damaged(self, tmp_path):
        path = tmp_path / "a.npz"
        density = made_up_density()
        density.save(path)
        content = path.read_bytes()
        refused = 0
        for first in range(len(content) - 5):
            path.write_bytes(content[:first] + bytes([255] * 5) + content[first + 5 :])
            try:
                loaded = AssistDensity.load(path)
            except ValueError as error:
                refused += "a.npz" in str(error)
            else:  # a time stamp, say
                assert torch.equal(loaded.end.grid, density.end.grid)
        assert refused > 0.8 * len(content)

    def test_a_single_array_is_no_density_file(self, tmp_path):
        path = tmp_path / "a.npy"
        np.save(path, np.ones((3, 3)))
        with pytest.raises(ValueError, match=r"a\.npy is not a readable density file"):
            AssistDensity.load(path)

    def test_a_pickle_is_not_run(self, tmp_path):
        path, evil = tmp_path / "a.npz", tmp_path / "evil"

        class Evil:
            def __reduce__(self):
                return Path.touch, (evil,)

        np.savez(path, metadata=np.array([Evil()], dtype=object), start=np.ones(1), end=np.ones(1))
        with pytest.raises(ValueError, match="not a readable density file"):
            AssistDensity.load(path)
        assert not evil.exists()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"start": None}, r"lacks the entries \['start'\]"),
            ({"metadata": None}, r"lacks the entries \['metadata'\]"),
            ({"start": np.ones(5)}, r"a\.npz: start: grid has shape \(5,\)"),
            ({"end": np.array([[1.0, np.nan]] * 2)}, "end: grid contains NaN"),
            ({"end": np.array([[1.0, -2.0]] * 2)}, r"end: grid contains a negative value \(-2.0\)"),
            ({"end": np.ones((3, 3), int)}, "end: its grid has dtype int64"),
            ({"metadata": np.array("{")}, "metadata is not JSON"),
            ({"metadata": np.array("[1]")}, "does not say format"),
            ({"format": "other"}, "does not say format 'fbrl-assist-density'"),
            ({"version": 2}, "format version 2; this fbrl reads up to 1. Upgrade fbrl"),
            ({"version": "1"}, "format version '1'"),
            ({"credit": None}, r"metadata lacks \['credit'\]"),
            ({"peak_end": None}, r"metadata lacks \['peak_end'\]"),
            ({"peak_end": "high"}, "end: peak is 'high'; it must be a number"),
            ({"peak_end": -0.1}, "end: peak is -0.1"),
            ({"n": "many"}, "in its metadata n is 'many'"),
            ({"counts": 5}, "in its metadata counts is 5"),
        ],
    )
    def test_a_wrong_file_is_named_with_the_value(self, tmp_path, change, message):
        path = tmp_path / "a.npz"
        made_up_density().save(path)
        with np.load(path) as archive:
            entries = dict(archive)
        header = json.loads(str(entries["metadata"]))
        for key, value in change.items():
            target = entries if key in entries else header
            if value is None:
                del target[key]
            else:
                target[key] = value
        if "metadata" in entries and "metadata" not in change:
            entries["metadata"] = np.array(json.dumps(header))
        np.savez(path, **entries)
        with pytest.raises(ValueError, match=message) as caught:
            AssistDensity.load(path)
        assert str(path) in str(caught.value)


class TestShipped:
    def test_says_where_it_comes_from(self):
        metadata = AssistDensity.default().metadata
        assert metadata.n == 474
        assert metadata.credit == "Data: StatsBomb"
        assert metadata.bandwidth_start == pytest.approx(0.0796, abs=5e-5)
        assert metadata.bandwidth_end == pytest.approx(0.0456, abs=5e-5)
        assert metadata.max_interpolation_error <= 0.005

    def test_holds_surfaces_and_nothing_else(self):
        from importlib import resources

        content = resources.files("fbrl.density").joinpath("open_play_assists_2015_16.npz")
        with np.load(io.BytesIO(content.read_bytes())) as archive:
            assert {key: archive[key].ndim for key in archive} == {
                "metadata": 0,
                "start": 2,
                "end": 2,
            }

    def test_assists_end_in_front_of_the_goal(self):
        density = AssistDensity.default()
        assert density.end.grid.max() == density.start.grid.max() == 1.0
        x, y = grid_positions(*density.end.grid.shape)[
            np.unravel_index(int(density.end.grid.argmax()), density.end.grid.shape)
        ]
        assert x > 0.75
        assert abs(y) < 0.15
        own_goal = torch.tensor([-0.8, 0.0])
        assert density.end(own_goal) < 1e-3 * density.end.peak

    @needs_data
    def test_is_what_the_command_fits_to_the_table(self, tmp_path):
        with pytest.raises(SystemExit) as ended:
            main(["fit", "--csv", str(ASSISTS), "--out", str(tmp_path / "new.npz")])
        assert ended.value.code == 0
        fitted, shipped = AssistDensity.load(tmp_path / "new.npz"), AssistDensity.default()
        torch.testing.assert_close(fitted.start.grid, shipped.start.grid, atol=1e-6, rtol=0)
        torch.testing.assert_close(fitted.end.grid, shipped.end.grid, atol=1e-6, rtol=0)
        for field in dataclasses.fields(DensityMetadata):
            ours, theirs = (getattr(d.metadata, field.name) for d in (fitted, shipped))
            assert ours == (
                pytest.approx(theirs, rel=1e-4) if isinstance(theirs, float) else theirs
            )

    @needs_data
    def test_is_the_fit_of_the_474_assists(self):
        starts, ends = starts_and_ends(read_passes_csv(ASSISTS).rows)
        shipped = AssistDensity.default()
        for points, density in ((starts, shipped.start), (ends, shipped.end)):
            h = bandwidth(points)
            nodes = grid_positions(*density.grid.shape).reshape(-1, 2)
            covariance = h**2 * np.eye(2)
            highest = kernel_sum(points, nodes, covariance).max()
            queries = np.random.default_rng(0).uniform([-1, -0.42], [1, 0.42], (300, 2))
            exact = [kernel_density(points, h, x, y) / highest for x, y in queries]
            error = np.abs(density(torch.from_numpy(queries)).numpy() / density.peak - exact)
            assert error.max() <= 0.005


def test_needs_neither_gfootball_nor_its_table():
    code = (
        "import sys; sys.modules['gfootball'] = sys.modules['fbrl_engine'] = None\n"
        "import fbrl.transforms\n"
        "fbrl.transforms.AssistDensityReward()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
