"""``fbrl-plot``: what it draws and prints, and how it answers bad input."""

from __future__ import annotations

import functools
import re

import pytest
from written_runs import GOALS, write_run, write_table

pytest.importorskip("matplotlib")
from matplotlib.image import imread

from fbrl.cli.plot import main

FRAMES = (100_000, 200_000, 300_000)


@pytest.fixture(autouse=True)
def directory(tmp_path, monkeypatch):
    """Two seeds with one reward and one with another, and a run of another scenario."""
    monkeypatch.chdir(tmp_path)
    final = (0.5, 0.25, 0.75)
    for name, values, settings in (
        ("a0", (0.0, 0.25, 0.5), {}),
        ("a1", (0.0, 0.5, 1.0), {"seed": 1}),
        ("b0", (0.0, 0.1, 0.0), {"reward": "scoring"}),
        ("corner", (0.0, 0.1, 0.2), {"scenario": "academy_corner"}),
    ):
        columns = {"frames": FRAMES, GOALS: values, "match/length": (9, 8, 7)}
        write_run(tmp_path / name, columns, final, **settings)
    return tmp_path


@pytest.fixture
def run(run_main):
    return functools.partial(run_main, main)


@pytest.fixture
def table(directory):
    goals = ("goal_difference", "goal_difference_low", "goal_difference_high")
    columns = {
        "policy": ("a0",), "configuration": ("analytics",), "reward": ("analytics",),
        "trained_on": ("academy_corner",),
        "seed": (0,), "scenario": ("academy_pass_and_shoot_with_keeper",), "mode": ("sample",),
        **dict.fromkeys(goals, (0.125,)),
    }  # fmt: skip
    return write_table(directory / "eval.csv", columns)


def pictures(directory):
    return {path.name for path in directory.rglob("*") if path.suffix in (".png", ".svg")}


class TestCurves:
    def test_seeds_are_pooled_and_both_kinds_of_file_written(self, run, directory):
        printed = run("curves", "a0", "a1", "b0", "--out", "c.png", "c.svg").out
        assert "analytics: 2 seeds, 0.750 at 300,000 frames\n" in printed
        assert "scoring: 1 seed, 0.000 at 300,000 frames\n" in printed
        assert "Written to c.svg\n" in printed
        assert pictures(directory) == {"c.png", "c.svg"}
        assert imread("c.png").shape[1] > 1000
        text = (directory / "c.svg").read_text()
        for part in ("analytics (2 seeds)", "scoring (1 seed)", "academy_3_vs_1_with_keeper"):
            assert part in text

    def test_a_threshold_tells_when_each_run_reached_it(self, run):
        arguments = ("curves", "a0", "b0", "--threshold", "0.1", "--out", "c.svg")
        printed = run(*arguments).out
        assert "  a0: 0.1 kept from 200,000 frames on\n" in printed
        # From 0.1 it falls to 0, which the tolerance forgives unless it is told not to.
        assert "  b0: 0.1 kept from 200,000 frames on\n" in printed
        printed = run(*arguments, "--tolerance", "0").out
        assert "  b0: 0.1 not reached and kept\n" in printed

    def test_labels_title_metric_and_smoothing_reach_the_figure(self, run, directory):
        printed = run(
            *("curves", "a0", "a1", "b0", "--metric", "match/length", "--smooth", "3"),
            *("--label", "with densities", "goals alone", "--title", "Ours", "--out", "c.svg"),
        ).out
        assert "with densities: 2 seeds, 8.000 at" in printed
        text = (directory / "c.svg").read_text()
        for part in ("goals alone (1 seed)", "Ours", "length of a match"):
            assert part in text

    def test_each_run_can_be_drawn_for_itself(self, run, directory):
        run("curves", "a0", "a1", "--each", "--out", "c.svg")
        text = (directory / "c.svg").read_text()
        assert "a0 (1 seed)" in text
        assert "a1 (1 seed)" in text

    def test_that_a_run_ends_early_is_told(self, run, directory):
        table = directory / "a1" / "metrics.csv"
        table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))
        printed = run("curves", "a0", "a1", "--out", "c.svg").out
        assert "drawn up to 200,000 frames, where a1 ends and others don't" in printed

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["a0"], r"required: --out \(see fbrl-plot curves --help\)"),
            (["--out", "c.png"], "required: RUN"),
            (["nowhere", "--out", "c.png"], r"no run at nowhere.*config\.json"),
            (["a0", "corner", "--out", "c.png"], "2 scenarios, academy_3_vs_1.*academy_corner"),
            (["a0", "--metric", "match/lenght", "--out", "c.png"], r"Did you mean match/length\?"),
            (["a0", "a0", "--out", "c.png"], "both seed 0"),
            (["a0", "b0", "--label", "one", "--out", "c.png"], "1 labels for 2 .*analytics; sc"),
            (["a0", "--smooth", "0", "--out", "c.png"], r"0 is not in \[1, "),
            (["a0", "--tolerance", "-1", "--out", "c.png"], "-1 is not a finite number of"),
            (["a0", "--threshold", "nan", "--out", "c.png"], "nan is not a finite number"),
            (["a0", "--tolerance", "0.1", "--out", "c.png"], "--tolerance .*--threshold"),
            (["a0", "--out", "c.jpg"], r"c\.jpg: a picture's name must end in \.png or \.svg"),
            (["a0", "--out", "c.png", "no/c.png"], "no directory no to write"),
            (["a0", "--out", "c.png", "a.svg"], r"a\.svg is a directory"),
            (["a0", "--out", "/proc/c.png"], r"/proc/c\.png can't be written"),
        ],
    )
    def test_bad_input_is_one_line_and_exit_2_and_nothing_written(
        self, run, directory, arguments, message
    ):
        (directory / "a.svg").mkdir()
        printed = run("curves", *arguments, code=2)
        assert re.fullmatch(r"fbrl-plot curves: error: [^\n]+\n", printed.err)
        assert re.search(message, printed.err)
        assert pictures(directory) == {"a.svg"}

    @pytest.mark.parametrize("damage", ["gone", "empty", "cut off"])
    def test_a_run_without_metrics_is_one_line(self, run, directory, damage):
        path = directory / "a0" / "metrics.csv"
        text = path.read_text()
        path.unlink()
        if damage != "gone":
            path.write_text("" if damage == "empty" else text[:-4])
        printed = run("curves", "a0", "--out", "c.png", code=2)
        assert re.fullmatch(r"fbrl-plot curves: error: a0/metrics\.csv is [^\n]+\n", printed.err)
        assert not pictures(directory)


class TestBars:
    def test_goal_differences_of_scenarios_and_rewards(self, run, directory):
        printed = run("bars", "a0", "a1", "b0", "corner", "--out", "b.png", "b.svg").out
        for line in (
            r"academy_3_vs_1_with_keeper  analytics  0\.500 \[0\.500, 0\.500\] \(mean of 2 seeds\)",
            r"academy_3_vs_1_with_keeper  scoring    0\.500 \[0\.250, 0\.750\] \(1 seed\)",
            r"academy_corner              analytics  0\.500 \[0\.250, 0\.750\] \(1 seed\)",
        ):
            assert re.search(line, printed), printed
        assert pictures(directory) == {"b.png", "b.svg"}

    def test_convergence_in_frames_with_published_numbers_beside(self, run, directory):
        columns = {
            "scenario": ("academy_3_vs_1_with_keeper", "academy_empty_goal"),
            "reward": ("analytics", "analytics"),
            "value": (250_000, 1),
        }
        write_table(directory / "made_up.csv", columns)
        printed = run(
            *("bars", "a0", "a1", "b0", "--measure", "convergence", "--threshold", "0.5"),
            *("--reference", "made_up.csv", "--out", "b.svg"),
        ).out
        assert re.search(r"analytics +300,000 \(median of 2 seeds, 2 got there\)", printed)
        assert re.search(r"scoring +not reached \(1 seed\)", printed)
        assert re.search(r"analytics \(made_up\) +250,000\n", printed)
        assert "made_up.csv has 1 scenario that ours don't play" in printed
        assert "analytics (made_up)" in (directory / "b.svg").read_text()

    def test_generalisation_from_a_table(self, run, directory, table):
        printed = run("bars", table, "--measure", "generalisation", "--out", "b.svg").out
        assert re.search(r"academy_pass_and_shoot_with_keeper  analytics  0\.125", printed)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["nowhere"], "no run at nowhere"),
            (["a0", "--measure", "convergence"], "--threshold"),
            (["eval.csv", "--measure", "convergence", "--threshold", "1"], "give the directories"),
            (["a0", "--measure", "generalisation"], "fbrl-eval --scenario"),
            (["eval.csv"], r"eval\.csv has no row .* trained on"),
            (["a0/config.json"], r"config\.json is damaged: line 2"),
            (["a0", "--measure", "goals"], "invalid choice: 'goals'"),
            (["a0", "--threshold", "1"], "--threshold .*convergence"),
            (["a0", "--reference", "nowhere.csv"], r"nowhere\.csv cannot be read"),
            (["a0", "--reference", "eval.csv"], r"eval\.csv has no column value"),
        ],
    )
    def test_bad_input_is_one_line_and_exit_2_and_nothing_written(
        self, run, directory, table, arguments, message
    ):
        printed = run("bars", *arguments, "--out", "b.png", code=2)
        assert re.fullmatch(r"fbrl-plot bars: error: [^\n]+\n", printed.err)
        assert re.search(message, printed.err)
        assert not pictures(directory)

    def test_runs_without_an_evaluation_are_one_line(self, run, directory):
        (directory / "a0" / "evaluations.csv").unlink()
        assert "a0 has no evaluation" in run("bars", "a0", "--out", "b.png", code=2).err


def test_the_command_itself_draws(run_program, directory):
    done = run_program("fbrl-plot", "curves", "a0", "--out", "c.png")
    assert (done.returncode, done.stderr) == (0, "")
    assert pictures(directory) == {"c.png"}


def test_an_interrupt_is_one_line_and_exit_130(run, directory, monkeypatch):
    def interrupted(path):
        raise KeyboardInterrupt

    monkeypatch.setattr("fbrl.analysis.run_log.read_run_log", interrupted)
    printed = run("curves", "a0", "--out", "c.png", code=130)
    assert printed.err == "fbrl-plot curves: interrupted; nothing was written\n"
    assert not pictures(directory)


def test_help_teaches_with_examples(run):
    for command in ("curves", "bars"):
        assert run(command, "--help").out.count(f"  fbrl-plot {command} ") >= 3
