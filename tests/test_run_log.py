"""The log of a run, read back: what it holds, what is measured on it, and damaged files."""

from __future__ import annotations

import numpy as np
import pytest

from fbrl.analysis.run_log import RunLogError, frames_until, paper_goal_difference, read_run_log
from fbrl.checks import UnknownNameError
from fbrl.config import PPOConfig, TrainConfig
from fbrl.config_json import save_config
from fbrl.presets import preset_config
from fbrl.training import TrainListener, train

SCENARIO = "academy_3_vs_1_with_keeper"
TABLE = "frames,match/goal_difference,match/count\n"


@pytest.fixture
def run_dir(tmp_path):
    save_config(preset_config("light", SCENARIO), tmp_path / "config.json")
    return tmp_path


def read(run_dir, table):
    (run_dir / "metrics.csv").write_text(table)
    return read_run_log(run_dir)


class TestReading:
    def test_what_a_training_logged_comes_back(self, tmp_path):
        small = PPOConfig(total_frames=64, num_envs=2, num_steps=16, num_minibatches=2)
        config = TrainConfig(
            "academy_empty_goal_close", run_dir=tmp_path / "run", eval_episodes=0, ppo=small
        )
        shown = []
        train(config, TrainListener(on_metrics=lambda frames, row: shown.append(row)))
        log = read_run_log(tmp_path / "run")
        assert log.config == config
        assert log.frames.tolist() == [32, 64]
        assert np.isnan(log.metric("match/goal_difference")[0])  # no match has ended yet
        for name, value in shown[-1].items():
            assert log.metric(name)[-1] == value

    def test_a_run_without_evaluations_has_none(self, run_dir):
        assert read(run_dir, TABLE + "10,,0\n").evaluations == {}

    def test_the_order_of_the_columns_does_not_matter(self, run_dir):
        log = read(run_dir, "match/count,frames,new/one\n3,10,0.5\n")
        assert log.frames.tolist() == [10]
        assert log.metric("new/one").tolist() == [0.5]

    def test_an_unknown_metric_is_answered_with_the_run_and_the_nearest(self, run_dir):
        log = read(run_dir, "frames,match/count,reward/total\n10,0,\n")
        with pytest.raises(UnknownNameError, match=r"reward/totl'.*mean reward/total\?") as raised:
            log.metric("reward/totl")
        assert str(run_dir) in str(raised.value)

    def test_a_curve_has_only_the_points_with_a_value(self, run_dir):
        frames, values = read(run_dir, TABLE + "10,,0\n20,0.5,1\n").curve("match/goal_difference")
        assert (frames.tolist(), values.tolist()) == ([20], [0.5])

    def test_of_two_evaluations_at_the_same_frames_the_later_counts(self, run_dir):
        table = "frames,evaluation/matches\n0,1\n10,2\n10,3\n"
        (run_dir / "evaluations.csv").write_text(table)
        frames, values = read(run_dir, TABLE + "10,,0\n").curve("evaluation/matches")
        assert (frames.tolist(), values.tolist()) == ([0, 10], [1, 3])

    @pytest.mark.parametrize(
        ("table", "message"),
        [
            ("", "is empty"),
            (TABLE, "has no iteration yet"),
            ("match/count\n3\n", "no column frames"),
            (TABLE + "10,0.5,1\n20,0.", "line 3 has 2 values, the header 3 names"),
            (TABLE + "10,0.5,1\n20,0.5,1", "line 3 is cut off"),
            (TABLE + "10,0.5,1,7\n", "line 2 has 4 values, the header 3 names"),
            (TABLE + "10,0.5,1\n20,x.5,1\n", "line 3 has 'x.5' as match/goal_difference"),
            (TABLE + "20,0.5,1\n10,0.5,1\n", "after 20 frames come 10"),
            (TABLE + "20,0.5,1\n20,0.5,1\n", "after 20 frames come 20"),
        ],
    )
    def test_a_damaged_table_is_named_with_what_is_wrong(self, run_dir, table, message):
        with pytest.raises(RunLogError, match=rf"metrics\.csv.*{message}"):
            _ = read(run_dir, table).frames

    def test_a_table_that_is_no_text_is_named(self, run_dir):
        (run_dir / "metrics.csv").write_bytes(b"\xff\xfe\x00")
        with pytest.raises(RunLogError, match=r"metrics\.csv is not a CSV table"):
            _ = read_run_log(run_dir).frames

    def test_a_missing_table_is_named(self, run_dir):
        with pytest.raises(RunLogError, match=r"metrics\.csv is missing"):
            _ = read_run_log(run_dir).frames

    def test_a_damaged_table_of_evaluations_is_named(self, run_dir):
        (run_dir / "evaluations.csv").write_text("frames,evaluation/goal_difference\n0,0.1\n5\n")
        with pytest.raises(RunLogError, match=r"evaluations\.csv is damaged: line 3"):
            _ = read_run_log(run_dir).evaluations

    @pytest.mark.parametrize("name", ["nowhere", "metrics.csv"])
    def test_where_there_is_no_run_it_says_so(self, run_dir, name):
        (run_dir / "metrics.csv").write_text(TABLE)
        with pytest.raises(RunLogError, match=rf"no run at .*{name}.*no config\.json"):
            read_run_log(run_dir / name)

    @pytest.mark.parametrize(
        "text", ["", "{", "[]", '{"scenario": "x", "colour": 1}', "{}", '{"scenario": "x"}']
    )
    def test_a_damaged_configuration_is_named(self, run_dir, text):
        (run_dir / "config.json").write_text(text)
        with pytest.raises(RunLogError, match=r"config\.json is"):
            read_run_log(run_dir)


class TestFramesUntil:
    FRAMES = (10, 20, 30, 40, 50)

    @pytest.mark.parametrize(
        ("values", "expected"),
        [
            ((0.1, 0.2, 0.5, 0.6, 0.7), 30),
            ((0.1, 0.5, 0.4, 0.6, 0.7), 40),  # reached early, but not kept
            ((0.5, 0.6, 0.6, 0.6, 0.7), 10),
            ((0.1, 0.2, 0.3, 0.4, 0.5), 50),
            ((0.1, 0.6, 0.6, 0.6, 0.4), None),  # lost at the very end
            ((0.1, 0.2, 0.3, 0.4, 0.49), None),
            ((np.nan, np.nan, 0.6, 0.6, 0.6), 30),
            ((np.nan,) * 5, None),
        ],
    )
    def test_first_frame_from_which_on_the_threshold_is_kept(self, values, expected):
        assert frames_until(self.FRAMES, values, 0.5) == expected

    @pytest.mark.parametrize(
        ("values", "expected"),
        [
            ((0.1, 0.5, 0.45, 0.6, 0.45), 20),  # every dip is forgiven
            ((0.1, 0.5, 0.35, 0.45, 0.6), 50),  # this one is not, and 0.45 does not reach it
            ((0.45, 0.45, 0.45, 0.45, 0.45), None),
        ],
    )
    def test_a_tolerance_forgives_dips_but_lowers_no_threshold(self, values, expected):
        assert frames_until(self.FRAMES, values, 0.5, tolerance=0.1) == expected


class TestPaperGoalDifference:
    ROWS = TABLE + "10,,0\n20,0.25,4\n30,0.5,8\n"

    @pytest.mark.parametrize(
        ("frames", "expected"), [(20, 0.25), (29, 0.25), (30, 0.5), (10, None), (5, None)]
    )
    def test_the_mean_at_the_last_iteration_before_a_number_of_frames(
        self, run_dir, frames, expected
    ):
        assert paper_goal_difference(read(run_dir, self.ROWS), frames) == expected

    def test_a_run_that_was_not_as_long_has_none(self, run_dir):
        assert paper_goal_difference(read(run_dir, self.ROWS), 31) is None
