"""A sweep over a grid on a real Ray cluster, interrupted and finished."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from conftest import REPOSITORY

SWEEP = REPOSITORY / "experiments" / "sweep"
GRID = """
scenario: academy_empty_goal
seed: [0, 1]
network.hidden-sizes: [[16, 16]]
num-envs: 2
num-steps: 64
total-frames: 6400
checkpoint-interval: 128
eval-episodes: 0
device: cpu
"""


@pytest.fixture
def read_grid(monkeypatch):
    """The sweep's own reading, whose points the tests look at."""
    monkeypatch.syspath_prepend(SWEEP)
    yield importlib.import_module("grid").read_grid
    sys.modules.pop("grid", None)
    sys.modules.pop("run", None)


@pytest.fixture
def start(tmp_path):
    """Starts a sweep as a user would."""
    started = []

    def start(grid=GRID):
        (tmp_path / "grid.yaml").write_text(grid)
        started.append(
            subprocess.Popen(
                [sys.executable, SWEEP / "run.py", "grid.yaml", "runs"],
                cwd=tmp_path,
                env={**os.environ, "RAY_ADDRESS": "local"},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()


def wait_for_frames(points, process):
    """Waits until one of the trainings has logged more; returns which."""
    before = [point.frames_done() for point in points]
    give_up = time.monotonic() + 300
    while time.monotonic() < give_up and process.poll() is None:
        for point, frames in zip(points, before, strict=True):
            if point.frames_done() > frames:
                return point
        time.sleep(0.1)
    process.kill()
    raise AssertionError("\n".join(process.communicate(timeout=60)))


@pytest.mark.slow
def test_a_sweep_that_is_interrupted_is_finished_by_the_same_command(tmp_path, start, read_grid):
    # What is in its way lets the second training fail.
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "seed=1").write_text("")
    process = start()
    points = read_grid(tmp_path / "grid.yaml", tmp_path / "runs")
    assert [point.run_dir.name for point in points] == ["seed=0", "seed=1"]
    training = wait_for_frames(points, process)
    process.send_signal(signal.SIGUSR1)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130, output + errors
    assert "2 trainings: 0 are finished and skipped, 0 go on, 2 begin." in output
    assert "saved and ended with exit code 130" in training.log.read_text()
    assert not training.is_finished()

    process = start()
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 1, output + errors
    assert "2 trainings: 0 are finished and skipped, 1 go on, 1 begin." in output
    assert "Going on after" in training.log.read_text()
    assert training.is_finished()
    assert "runs/seed=0: finished" in output
    assert "seed=1: failed with exit code 2 (fbrl-train: error: The run directory" in output
    assert "1 of 2 trainings are finished." in output
    assert "fbrl-plot curves runs/*/ --out academy_empty_goal.png" in output


PARENT = """
import subprocess, sys
sys.path.insert(0, sys.argv[1])
from run import end_with_parent
child = subprocess.Popen(["sleep", "600"], preexec_fn=end_with_parent())
print(child.pid, flush=True)
child.wait()
"""


def test_a_training_ends_with_the_process_that_began_it_however_that_ends():
    parent = subprocess.Popen([sys.executable, "-c", PARENT, SWEEP], stdout=subprocess.PIPE)
    child = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.wait()
    child.wait(10)


def test_points_are_the_combinations_of_the_lists(tmp_path, read_grid):
    path = tmp_path / "grid.yaml"
    path.write_text(
        "scenario: [academy_corner, academy_empty_goal]\n"
        "seed: [0, 1]\n"
        "eval-untrained: true\n"
        "network.hidden-sizes: [[8, 4]]\n"
    )
    points = read_grid(path, tmp_path)
    assert [point.run_dir.name for point in points] == [
        "scenario=academy_corner,seed=0",
        "scenario=academy_corner,seed=1",
        "scenario=academy_empty_goal,seed=0",
        "scenario=academy_empty_goal,seed=1",
    ]
    config = points[3].config
    assert (config.scenario, config.seed, config.network_options, config.eval_untrained) == (
        "academy_empty_goal",
        1,
        {"hidden_sizes": (8, 4)},
        True,
    )
    assert not points[3].is_finished()


def test_settings_are_combined_with_the_rest_and_name_the_runs(tmp_path, read_grid):
    path = tmp_path / "grid.yaml"
    path.write_text(
        "scenario: academy_empty_goal\nseed: [0, 1]\n"
        "settings:\n  light: {}\n  all of it: {observation: players, gamma: [0.99, 0.9]}\n"
    )
    points = read_grid(path, tmp_path)
    assert [point.run_dir.name for point in points] == [
        "setting=light,seed=0",
        "setting=light,seed=1",
        "setting=all_of_it,seed=0,gamma=0.99",
        "setting=all_of_it,seed=0,gamma=0.9",
        "setting=all_of_it,seed=1,gamma=0.99",
        "setting=all_of_it,seed=1,gamma=0.9",
    ]
    assert [point.config.observation for point in points] == ["simple115"] * 2 + ["players"] * 4
    assert points[-1].config.ppo.gamma == 0.9


def test_several_grids_are_gone_through_in_their_order(tmp_path, read_grid):
    path = tmp_path / "grid.yaml"
    path.write_text(
        "grids:\n"
        "  rewards: {scenario: academy_corner, reward: [scoring, analytics]}\n"
        "  seeds: {scenario: academy_empty_goal, seed: [0, 1]}\n"
    )
    assert [point.run_dir.name for point in read_grid(path, tmp_path)] == [
        "grid=rewards,reward=scoring",
        "grid=rewards,reward=analytics",
        "grid=seeds,seed=0",
        "grid=seeds,seed=1",
    ]


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ("grids: [a]", "each with a name of its own"),
        ("grids: {a: {scenario: academy_corner}}\nseed: 1", "and not only these"),
        ("grids: {a: {seed: 1}}", "no options of fbrl-train"),
        ("seed: [0, 1]", "no options of fbrl-train, with a scenario among them"),
        ("scenario: [", "is no YAML"),
        ("scenario: academy_corner\nseed: [0, 0]", "would have the same directory"),
        ("scenario: academy_corner\nseed: []", "has an empty list"),
        ("scenario: academy_corner\nrun-dir: here", "has run-dir, which the sweep itself sets"),
        ("scenario: academy_corner\nsettings: [light]", "settings that are no options by names"),
        ("scenario: academy_corner\nsettings: {a: {run-dir: b}}", "has run-dir, which the sweep"),
    ],
)
def test_a_grid_that_is_none_is_an_error(tmp_path, read_grid, grid, message):
    path = tmp_path / "grid.yaml"
    path.write_text(grid)
    with pytest.raises(ValueError, match=message):
        read_grid(path, tmp_path)


def test_runs_that_a_table_names_are_left_out(tmp_path, read_grid, capsys):
    unless_in = importlib.import_module("run").unless_in
    path, table = tmp_path / "grid.yaml", tmp_path / "results.csv"
    path.write_text("scenario: academy_corner\nseed: [0, 1]")
    points = read_grid(path, tmp_path)
    table.write_text("policy,mode\nseed=0,sample\nseed=0,greedy\n")
    assert unless_in(table, points) == points[1:]
    assert capsys.readouterr().out.startswith("1 trainings are in ")
    table.write_text("policy\nseed=0\nseed=1\n")
    with pytest.raises(ValueError, match="All 2 trainings of the grid are in"):
        unless_in(table, points)
    table.write_text("run\nseed=0\n")
    with pytest.raises(ValueError, match="has no column policy, but run"):
        unless_in(table, points)


def test_an_option_that_does_not_exist_is_refused_in_one_line(tmp_path, start):
    process = start("scenario: academy_corner\nlearning-rat: 1")
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 2
    assert output == ""
    assert errors.count("\n") == 1
    assert "learning-rat" in errors
    assert not (tmp_path / "runs").exists()
