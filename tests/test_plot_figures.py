"""What is drawn in learning curves and bar charts, and the files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from written_runs import GOALS, write_run

pytest.importorskip("matplotlib")
from matplotlib.colors import to_hex
from matplotlib.image import imread

from fbrl.analysis.results import (
    PooledResult,
    Published,
    Result,
    ResultsError,
    pool_results,
    published_beside,
)
from fbrl.analysis.run_groups import RunGroup, learning_curve
from fbrl.analysis.run_log import read_run_log
from fbrl.checks import UnknownNameError
from fbrl.figures.bars import bars_figure
from fbrl.figures.curves import learning_curves_figure
from fbrl.figures.files import save_figure
from fbrl.figures.style import COLOURS


def legend(figure):
    (box,) = figure.legends
    return [text.get_text() for text in box.get_texts()], box.get_title().get_text()


class TestLearningCurves:
    @pytest.fixture
    def group(self, tmp_path):
        def group(*curves, label="ours"):
            runs = []
            for seed, values in enumerate(curves):
                columns = {"frames": range(100, 100 * len(values) + 1, 100), GOALS: values}
                path = tmp_path / f"{label}{seed}"
                runs.append(read_run_log(write_run(path, columns, seed=seed)))
            return RunGroup(label, tuple(runs))

        return group

    def test_the_line_is_the_mean_of_the_seeds_and_the_band_its_interval(self, group):
        curve = learning_curve(group([0, 1, 7], [0, 3, 7], [0, 5, 7]), GOALS)
        axes = learning_curves_figure([curve], GOALS, "title").axes[0]
        x, y = axes.lines[0].get_data()
        assert (x.tolist(), y.tolist()) == ([100, 200, 300], [0, 3, 7])
        (band,) = axes.collections
        corners = band.get_paths()[0].vertices
        at_200 = corners[corners[:, 0] == 200, 1]
        assert 1 <= at_200.min() < 3 < at_200.max() <= 5
        assert set(corners[corners[:, 0] == 300, 1]) == {7}

    def test_a_single_seed_has_a_line_without_band_and_says_so(self, group):
        figure = learning_curves_figure([learning_curve(group([0, 1]), GOALS)], GOALS, "")
        assert not figure.axes[0].collections
        assert legend(figure) == (["ours (1 seed)"], "")

    def test_the_legend_names_curves_seeds_threshold_and_band(self, group):
        curves = [
            learning_curve(group([0, 1], [1, 2]), GOALS),
            learning_curve(group([3, 1], label="theirs"), GOALS),
        ]
        figure = learning_curves_figure(curves, GOALS, "a scenario", threshold=0.25)
        texts, title = legend(figure)
        assert texts == ["ours (2 seeds)", "theirs (1 seed)", "threshold 0.25"]
        assert title == "line: mean of the seeds, band: its 95 % interval"
        axes = figure.axes[0]
        assert [to_hex(line.get_color()) for line in axes.lines[:2]] == [
            colour.lower() for colour in COLOURS[:2]
        ]
        assert list(axes.lines[2].get_ydata()) == [0.25, 0.25]
        assert axes.get_title() == "a scenario"
        assert axes.get_ylabel() == "goal difference per match,\nlast 100 training matches"

    @pytest.mark.parametrize(
        ("end", "label", "tick"),
        [(400_000, "thousands", "200"), (4_000_000, "millions", "0.2")],
    )
    def test_frames_are_counted_in_thousands_or_millions(self, tmp_path, end, label, tick):
        run = write_run(tmp_path / "run", {"frames": [1, end], GOALS: [0, 1]})
        curve = learning_curve(RunGroup("a", (read_run_log(run),)), GOALS)
        axes = learning_curves_figure([curve], GOALS, "").axes[0]
        assert axes.get_xlabel() == f"environment frames ({label})"
        assert axes.xaxis.get_major_formatter()(200_000, 0) == tick

    def test_before_the_first_match_and_after_the_shortest_run_nothing_is_pooled(self, group):
        curve = learning_curve(group(["", 1, 2, 3], ["", "", 4, 5], [1, 1, 3]), GOALS)
        assert (curve.frames.tolist(), curve.mean.tolist()) == ([300], [3.0])

    def test_runs_without_common_frames_are_named(self, group):
        with pytest.raises(ValueError, match=r"no frames at which .*ours0 and .*ours1"):
            learning_curve(group(["", 1], [1, ""]), GOALS)

    def test_a_run_without_a_single_value_is_named(self, group):
        with pytest.raises(ValueError, match=r"no frames at which .*ours0 have a value"):
            learning_curve(group(["", ""]), GOALS)

    def test_smoothing_takes_the_last_points_of_each_run(self, group):
        curve = learning_curve(group([0, 2, 4, 12]), GOALS, smooth=3)
        assert curve.mean.tolist() == [0, 1, 2, 6]

    def test_evaluations_can_be_drawn_too(self, tmp_path):
        run = write_run(tmp_path / "run", {"frames": [500, 1000]}, (0.5, 0.4, 0.6))
        group = RunGroup("a", (read_run_log(run),))
        curve = learning_curve(group, "evaluation/goal_difference")
        assert (curve.frames.tolist(), curve.mean.tolist()) == ([0, 1000], [0, 0.5])

    def test_an_unknown_metric_is_answered_with_the_nearest(self, group):
        with pytest.raises(UnknownNameError, match=rf"Did you mean {GOALS}\?"):
            learning_curve(group([1]), "match/goal_diference")


def result(agent, value, seed=0, scenario="academy_corner", low=None, high=None):
    return Result(scenario, agent, agent, seed, value, low, high)


class TestPooling:
    def test_seeds_give_their_mean_with_an_interval_over_them(self):
        values = [0.0, 0.1, 0.5]
        (bar,) = pool_results(
            [result("scoring", value, seed) for seed, value in enumerate(values)], "goal-difference"
        )
        assert (bar.value, bar.values) == (pytest.approx(0.2), tuple(values))
        assert 0 <= bar.low < 0.2 < bar.high <= 0.5

    def test_a_single_seed_has_the_interval_of_its_matches(self):
        (bar,) = pool_results([result("scoring", 0.3, low=0.2, high=0.4)], "goal-difference")
        assert (bar.value, bar.low, bar.high) == (0.3, 0.2, 0.4)

    @pytest.mark.parametrize(
        ("frames", "median"),
        [
            ([30, 10, 20], 20),
            ([30, 10, math.inf], 30),
            ([30, math.inf, math.inf], math.inf),
            ([10, 20], 20),
            ([10, math.inf], math.inf),
        ],
    )
    def test_convergence_is_a_median_where_never_is_last(self, frames, median):
        (bar,) = pool_results(
            [result("scoring", value, seed) for seed, value in enumerate(frames)], "convergence"
        )
        assert (bar.value, bar.low, bar.high) == (median, None, None)
        assert bar.reached == sum(map(math.isfinite, frames))

    def test_a_seed_cannot_count_twice(self):
        with pytest.raises(ResultsError, match="scoring in academy_corner has two results"):
            pool_results([result("scoring", 0.1), result("scoring", 0.2)], "goal-difference")

    def test_published_numbers_of_scenarios_that_ours_lack_are_left_out(self):
        ours = pool_results([result("scoring", 0.3)], "goal-difference")
        published = [
            Published("academy_corner", "checkpoints", 0.7),
            Published("academy_pass_and_shoot_with_keeper", "scoring", 0.8),
        ]
        (bar,) = published_beside(ours, published, "thesis")
        assert (bar.agent, bar.value, bar.values) == ("checkpoints (thesis)", 0.7, ())


class TestBars:
    def bar(self, agent, height, scenario="academy_corner", reward=None, values=None):
        values = (height,) if values is None else values
        return PooledResult(scenario, agent, reward or agent, height, None, None, values)

    def test_heights_are_the_numbers_at_their_scenarios(self):
        other = "academy_3_vs_1_with_keeper"
        bars = [
            self.bar("analytics", 0.5), self.bar("scoring", 0.25),
            self.bar("scoring", -0.125, other),
        ]  # fmt: skip
        figure = bars_figure(bars, "goal-difference", "title")
        axes = figure.axes[0]
        analytics, scoring = axes.containers
        assert [patch.get_height() for patch in analytics] == [0.5]
        assert [patch.get_height() for patch in scoring] == [0.25, -0.125]
        middles = [patch.get_x() + patch.get_width() / 2 for patch in [*analytics, *scoring]]
        assert middles == pytest.approx([-0.2, 0.2, 1.2])
        assert [tick.get_text() for tick in axes.get_xticklabels()] == [
            "corner",
            "3 vs 1\nwith keeper",
        ]
        assert legend(figure)[0] == ["analytics", "scoring"]
        assert axes.get_ylabel() == "goal difference per match"

    def test_published_bars_are_hatched_beside_ours_in_the_same_colour(self):
        bars = [
            self.bar("analytics", 0.5), self.bar("scoring", 0.2),
            self.bar("analytics (thesis)", 0.4, reward="analytics", values=()),
        ]  # fmt: skip
        figure = bars_figure(bars, "goal-difference", "")
        ours, published, _ = (container[0] for container in figure.axes[0].containers)
        assert legend(figure)[0] == ["analytics", "analytics (thesis)", "scoring"]
        assert published.get_height() == 0.4
        assert (ours.get_hatch(), published.get_hatch()) == (None, "///")
        assert to_hex(published.get_edgecolor()) == to_hex(ours.get_facecolor())
        assert to_hex(published.get_facecolor()) == "#ffffff"

    def test_intervals_and_seeds_are_drawn(self):
        bar = PooledResult("academy_corner", "scoring", "scoring", 0.5, 0.25, 0.625, (0.25, 0.75))
        figure = bars_figure([bar], "generalisation", "")
        axes = figure.axes[0]
        (interval,) = axes.containers[1].lines[2]
        np.testing.assert_allclose(interval.get_segments()[0][:, 1], [0.25, 0.625])
        dots = [line for line in axes.lines if line.get_marker() == "o"]
        assert dots[0].get_ydata().tolist() == [0.25, 0.75]
        assert legend(figure)[1] == "means and 95 % intervals over seeds (dots)"

    def test_what_was_never_reached_is_said_in_words(self):
        bars = [
            self.bar("analytics", math.inf),
            self.bar("scoring", 3e6, values=(2e6, 3e6, math.inf)),
        ]
        figure = bars_figure(bars, "convergence", "")
        axes = figure.axes[0]
        assert [text.get_text() for text in axes.texts] == ["not reached", "2 of 3 seeds"]
        assert [box[0].get_height() for box in axes.containers] == [0, 3e6]
        assert axes.get_ylabel() == "convergence,\nenvironment frames (millions)"

    def test_that_nobody_got_there_can_be_drawn(self, tmp_path):
        figure = bars_figure([self.bar("analytics", math.inf)], "convergence", "")
        save_figure(figure, tmp_path / "a.png")
        assert [text.get_text() for text in figure.axes[0].texts] == ["not reached"]


class TestFiles:
    BAR = PooledResult("academy_corner", "scoring", "scoring", 0.5, 0.25, 0.625, (0.5,))

    def test_both_kinds_can_be_opened_again_and_are_the_same_each_time(self, tmp_path):
        written = []
        for _ in range(2):
            figure = bars_figure([self.BAR], "goal-difference", "title")
            save_figure(figure, tmp_path / "a.png", tmp_path / "a.svg")
            written.append([(tmp_path / name).read_bytes() for name in ("a.png", "a.svg")])
        assert written[0] == written[1]
        height, width, _ = imread(tmp_path / "a.png").shape
        assert width > height > 600
        assert "goal difference per match" in (tmp_path / "a.svg").read_text()

    def test_all_files_are_written_or_none(self, tmp_path):
        figure = bars_figure([self.BAR], "goal-difference", "")
        with pytest.raises(OSError, match="nowhere"):
            save_figure(figure, tmp_path / "a.png", tmp_path / "nowhere" / "a.png")
        assert not list(tmp_path.iterdir())
