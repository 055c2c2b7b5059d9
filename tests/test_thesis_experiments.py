"""The report of the thesis's experiments, on a small copy of their grid."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sys
from collections import Counter
from pathlib import Path

import pytest
import yaml

from fbrl.files.csv_table import read_csv_table
from fbrl.training import train

REPORT = Path(__file__).parents[1] / "experiments" / "thesis" / "report.py"
GRID = """
grids:
  rewards: &rewards
    scenario: academy_empty_goal_close
    reward: [analytics, scoring]
    seed: [0, 1]
    total-frames: 1024
    num-envs: 4
    num-steps: 64
    num-minibatches: 1
    eval-episodes: 2
    eval-pictures: false
  control:
    <<: *rewards
    reward: analytics
    reward.density: uniform
    seed: 0
  not begun:
    scenario: academy_corner
"""


@pytest.fixture(scope="module")
def report():
    spec = importlib.util.spec_from_file_location("thesis_report", REPORT)
    module = importlib.util.module_from_spec(spec)
    before = list(sys.path)
    sys.path.insert(0, str(REPORT.parent))  # as where it is run
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


@pytest.fixture(scope="module")
def runs(report, tmp_path_factory):
    folder = tmp_path_factory.mktemp("thesis")
    grid = folder / "grid.yaml"
    grid.write_text(GRID)
    for point in report.read_grid(grid, folder / "runs"):
        if point.config.scenario == "academy_empty_goal_close":
            train(point.config)
    return grid, folder / "runs"


def test_every_figure_and_table_is_made_from_finished_runs(report, runs, tmp_path, monkeypatch):
    monkeypatch.setattr("figures.FIGURES", {"figure_6_1": ("academy_empty_goal_close",)})
    monkeypatch.setattr(report, "THRESHOLD", -1)  # reached with the first match
    monkeypatch.setattr(report, "ELSEWHERE", ["academy_empty_goal"])
    grid, folder = runs
    report.report(grid, folder, tmp_path / "out", scale=0.004, seeds_elsewhere=1)
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert made == {
        "results.md",
        "results.csv",
        "curves.csv",
        "figure_6_1_light.png",
        "curves_academy_empty_goal_close_light.png",
        "controls_academy_empty_goal_close.png",
        "generalisation.png",
    }
    rows = read_csv_table(tmp_path / "out" / "results.csv").rows
    assert Counter((row["scenario"], row["mode"]) for row in rows) == {
        ("academy_empty_goal_close", "sample"): 5,
        ("academy_empty_goal_close", "greedy"): 5,
        ("academy_empty_goal", "sample"): 3,  # one of each reward
    }
    text = (tmp_path / "out" / "results.md").read_text()
    assert "\n5 of 6 runs were finished.\n" in text
    assert "analytics" in text
    assert text.count("(one seed, no interval)") == 2
    seeds = {"analytics, light": 2, "scoring, light": 2, "analytics, light, density uniform": 1}
    assert re.findall(r"\n\| ([\w, ]+) \| (\w+) \| (\d) \|", text) == [
        (label, mode, str(count)) for label, count in seeds.items() for mode in ("sample", "greedy")
    ]
    assert len(re.findall(r"\| [\d,]+; [\d,]+ \|\n", text)) == 4  # configurations and modes
    # What was played is kept, and the same when it is read again.
    monkeypatch.setattr(report, "play", None)
    report.report(grid, folder, tmp_path / "again", scale=0.004, seeds_elsewhere=1)
    for name in ("results.md", "results.csv", "curves.csv"):
        assert (tmp_path / "again" / name).read_text() == (tmp_path / "out" / name).read_text()


def test_runs_whose_directories_are_gone_stay_in_the_report(report, runs, tmp_path, monkeypatch):
    monkeypatch.setattr("figures.FIGURES", {})
    monkeypatch.setattr(report, "THRESHOLD", 2)  # reached in no match of this scenario
    grid, folder = runs
    report.report(grid, folder, tmp_path / "out", scale=0.004)
    some = tmp_path / "some"
    shutil.copytree(folder, some, ignore=shutil.ignore_patterns("*analytics*"))
    report.report(grid, some, tmp_path / "kept", scale=0.004)
    assert "3 of 6 runs" in (tmp_path / "kept" / "results.md").read_text()
    report.report(grid, folder, tmp_path / "kept", scale=0.004)
    shutil.rmtree(some)
    report.report(grid, some, tmp_path / "kept", scale=0.004)
    rows = [read_csv_table(tmp_path / name / "results.csv").rows for name in ("kept", "out")]
    kept, together = ({(row["policy"], row["mode"]): row for row in table} for table in rows)
    assert kept == together
    assert (tmp_path / "kept" / "results.md").read_text().count("| never; never |\n") == 4
    assert (tmp_path / "kept" / "curves_academy_empty_goal_close_light.png").is_file()


def test_a_run_that_the_grid_does_not_have_is_refused(report, runs, tmp_path):
    grid, folder = runs
    (tmp_path / "results.csv").write_text("policy,frames\nreward=other,1024\n")
    with pytest.raises(ValueError, match="has reward=other, which is not in the grid"):
        report.report(grid, folder, tmp_path, scale=0.004)


def test_the_grid_of_the_thesis_is_one(report, tmp_path):
    grids = yaml.safe_load(report.GRID.read_text())
    for grid in grids["grids"].values():
        grid["seed"] = 0  # the others are read alike
    path = tmp_path / "grid.yaml"
    path.write_text(yaml.safe_dump(grids))
    points = report.read_grid(path, tmp_path / "runs")
    for scenarios in sys.modules["figures"].FIGURES.values():
        assert {point.config.scenario for point in points} >= set(scenarios)
