"""A sweep over a grid on a real Ray cluster, interrupted and finished."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import REPOSITORY

SCRIPT = REPOSITORY / "experiments" / "sweep" / "run.py"
GRID = """
scenario: academy_empty_goal
seed: [0, 1]
hidden-sizes: [[16, 16]]
num-envs: 2
num-steps: 64
total-frames: 2560
checkpoint-interval: 128
eval-episodes: 0
device: cpu
"""


@pytest.fixture
def sweep(tmp_path):
    """The runner as a module, whose names the tests look at."""
    spec = importlib.util.spec_from_file_location("sweep", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["sweep"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["sweep"]


def start(tmp_path, grid=GRID):
    (tmp_path / "grid.yaml").write_text(grid)
    return subprocess.Popen(
        [sys.executable, SCRIPT, tmp_path / "grid.yaml", tmp_path / "runs"],
        cwd=tmp_path,
        env={**os.environ, "RAY_ADDRESS": "local"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_a_sweep_that_is_interrupted_is_finished_by_the_same_command(tmp_path, sweep):
    process = start(tmp_path)
    points = sweep.read_grid(tmp_path / "grid.yaml", tmp_path / "runs")
    assert [point.run_dir.name for point in points] == ["seed=0", "seed=1"]
    give_up = time.monotonic() + 90
    while not any(point.share_done() for point in points) and time.monotonic() < give_up:
        time.sleep(0.1)
    process.send_signal(signal.SIGUSR1)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, output + errors
    assert not all(point.is_finished() for point in points)
    begun = [point for point in points if sweep.has_checkpoint(point.run_dir)]
    assert begun
    for point in begun:
        assert "saved and ended with exit code 130" in log(point)

    process = start(tmp_path)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, output + errors
    assert "2 of 2 trainings are finished." in output
    for point in points:
        assert point.is_finished()
    assert any("Going on after" in log(point) for point in begun)


def log(point) -> str:
    return Path(f"{point.run_dir}.output.log").read_text()


def test_points_are_the_combinations_of_the_lists(tmp_path, sweep):
    path = tmp_path / "grid.yaml"
    path.write_text(
        "scenario: [academy_corner, academy_empty_goal]\n"
        "seed: [0, 1]\n"
        "eval-untrained: true\n"
        "hidden-sizes: [[8, 4]]\n"
    )
    points = sweep.read_grid(path, tmp_path)
    assert [point.run_dir.name for point in points] == [
        "scenario=academy_corner,seed=0",
        "scenario=academy_corner,seed=1",
        "scenario=academy_empty_goal,seed=0",
        "scenario=academy_empty_goal,seed=1",
    ]
    config = points[3].config
    assert (config.scenario, config.seed, config.hidden_sizes, config.eval_untrained) == (
        "academy_empty_goal",
        1,
        (8, 4),
        True,
    )
    assert not points[3].is_finished()


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ("seed: [0, 1]", "no options of fbrl-train, with a scenario among them"),
        ("scenario: [", "is no YAML"),
        ("scenario: academy_corner\nseed: [0, 0]", "would have the same directory"),
    ],
)
def test_a_grid_that_is_none_is_an_error(tmp_path, sweep, grid, message):
    path = tmp_path / "grid.yaml"
    path.write_text(grid)
    with pytest.raises(ValueError, match=message):
        sweep.read_grid(path, tmp_path)


def test_an_option_that_does_not_exist_is_refused_in_one_line(tmp_path):
    process = start(tmp_path, "scenario: academy_corner\nlearning-rat: 1")
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert output == ""
    assert errors.count("\n") == 1
    assert "learning-rat" in errors
    assert not (tmp_path / "runs").exists()
