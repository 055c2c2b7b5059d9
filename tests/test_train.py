"""``fbrl-train`` from its command line to its files, on the real engine."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fbrl.assembly import make_model
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train import TrainDisplay, main
from fbrl.config import PPOConfig, TrainConfig
from fbrl.config_json import config_from_dict
from fbrl.envs import make_env
from fbrl.monitor import SCALARS
from fbrl.presets import preset_config

SCENARIO = "academy_pass_and_shoot_with_keeper"
SIZES = ("--num-envs", 4, "--num-steps", 128, "--total-frames", 1024)
SMALL = (*SIZES, "--eval-episodes", 8, "--no-eval-pictures")
WITHOUT_EVALUATION = (*SIZES, "--eval-episodes", 0)


def events(run_dir):
    accumulator = EventAccumulator(str(run_dir), size_guidance={"scalars": 0})
    accumulator.Reload()
    return {
        tag: [(event.step, event.value) for event in accumulator.Scalars(tag)]
        for tag in accumulator.Tags()["scalars"]
    }


def rows(run_dir):
    with (run_dir / "metrics.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def without_time(table):
    return [
        {name: value for name, value in row.items() if not name.startswith("time/")}
        for row in table
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One small training through the command, which several tests look at."""
    run_dir = tmp_path_factory.mktemp("train") / "run"
    program = Path(sys.executable).with_name("fbrl-train")
    arguments = [SCENARIO, "--seed", 3, "--run-dir", run_dir, "--eval-untrained", *SMALL]
    arguments += ["--eval-interval", 512]
    done = subprocess.run(
        [program, *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return run_dir, done


def test_it_prints_what_a_user_needs_and_nothing_on_stderr(run):
    run_dir, done = run
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert SCENARIO in lines[0]
    speed = r"[\d,]+ frames/s \([\d.]+ of \d+ cores play\)"
    assert re.search(rf"1,024/1,024 frames, {speed}, goal difference [+-]\d", done.stdout)
    for which in ("untrained", "trained"):
        assert re.search(rf"Goal difference, {which}: -?\d\.\d+ \[.*\] over 8 matches", done.stdout)
    # At the start, when there is something to watch, and at the end.
    for line in (lines[2], lines[-1]):
        assert re.search(rf"tensorboard --logdir {run_dir} --host localhost$", line)


def test_tensorboard_reads_every_documented_name(run):
    run_dir, _ = run
    scalars = events(run_dir)
    assert set(SCALARS) - {"reward/checkpoint", "reward/potential"} == set(scalars)
    frames = [512, 1024]
    for name, values in scalars.items():
        steps = [0, 512, 1024] if name.startswith("evaluation/") else frames
        assert [step for step, _ in values] == steps, name
        assert all(math.isfinite(value) for _, value in values), name


def test_the_metrics_make_sense(run):
    run_dir, _ = run
    last = {name: values[-1][1] for name, values in events(run_dir).items()}
    parts = ("reward/scoring", "reward/start_density", "reward/end_density")
    assert last["reward/total"] == pytest.approx(sum(last[name] for name in parts), abs=1e-5)
    assert last["match/goal_difference"] == pytest.approx(last["reward/scoring"])
    assert 0 < last["reward/start_density"] < 0.4
    assert 2.5 < last["ppo/entropy"] <= math.log(19) + 1e-6
    assert 0 < last["match/length"] <= 401
    assert 1 <= last["match/count"] <= 1024
    first_rate = preset_config("light", SCENARIO).ppo.learning_rate
    assert last["ppo/learning_rate"] == pytest.approx(first_rate / 2)
    low, high = (last[f"evaluation/goal_difference_{end}"] for end in ("low", "high"))
    assert low <= last["evaluation/goal_difference"] <= high


def test_the_table_equals_the_events(run):
    run_dir, _ = run
    scalars = events(run_dir)
    table = rows(run_dir)
    assert [int(row["frames"]) for row in table] == [512, 1024]
    for name, values in scalars.items():
        if not name.startswith("evaluation/"):
            column = [float(row[name]) for row in table]
            assert column == pytest.approx([value for _, value in values], rel=1e-5), name


def test_the_configuration_is_kept(run):
    run_dir, _ = run
    config = config_from_dict(json.loads((run_dir / "config.json").read_text()))
    assert (config.scenario, config.seed, config.run_dir) == (SCENARIO, 3, run_dir)
    assert config.ppo.num_envs == 4
    assert config.ppo.gamma == preset_config("light", SCENARIO).ppo.gamma


def test_the_checkpoint_holds_the_trained_policy(run):
    run_dir, _ = run
    checkpoint = load_checkpoint(run_dir)
    assert checkpoint["frames"] == 1024
    config = config_from_dict(checkpoint["config"])
    torch.manual_seed(config.seed)
    model = make_model(config, torch.device("cpu"))
    fresh = {name: value.clone() for name, value in model.state_dict().items()}
    model.load_state_dict(checkpoint["model"])
    assert any(not torch.equal(fresh[name], value) for name, value in model.state_dict().items())
    env = make_env(config.scenario, num_envs=2, seed=0)
    played = env.rollout(5, model.get_collection_policy())
    env.close()
    assert played["action"].shape == (2, 5)


def test_the_same_seed_gives_identical_metrics_and_weights(run, run_program, tmp_path):
    run_dir, _ = run
    # Without evaluations before the end, which must not change the training.
    arguments = [SCENARIO, "--seed", 3, *SMALL]
    again = run_program("fbrl-train", *arguments, "--run-dir", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    assert without_time(rows(tmp_path / "again")) == without_time(rows(run_dir))
    weights, other = (load_checkpoint(d)["model"] for d in (run_dir, tmp_path / "again"))
    for name, value in weights.items():
        assert torch.equal(value, other[name]), name
    last = events(tmp_path / "again")["evaluation/goal_difference"][-1]
    assert last == events(run_dir)["evaluation/goal_difference"][-1]


def test_another_seed_gives_another_training(run, run_main, tmp_path):
    run_dir, _ = run
    run_main(main, SCENARIO, "--seed", 4, *WITHOUT_EVALUATION, "--run-dir", tmp_path / "b")
    assert without_time(rows(tmp_path / "b")) != without_time(rows(run_dir))


@pytest.mark.parametrize(
    ("reward", "observation"),
    [
        ("analytics", "simple115"),
        ("potential", "simple115"),
        ("checkpoints", "minimap"),
        ("scoring", "smm"),
    ],
)
def test_every_reward_and_every_observation_is_trained_with(
    reward, observation, run_main, tmp_path
):
    arguments = ["academy_empty_goal_close", "--reward", reward, "--observation", observation]
    sizes = ["--num-envs", "2", "--num-steps", "32", "--total-frames", "64", "--num-epochs", "1"]
    run_main(main, *arguments, *sizes, "--eval-episodes", 0, "--run-dir", tmp_path / "run")
    names = set(rows(tmp_path / "run")[0])
    part = {
        "analytics": "reward/end_density",
        "potential": "reward/potential",
        "checkpoints": "reward/checkpoint",
    }.get(reward)
    assert part is None or part in names
    assert {"reward/scoring", "reward/total"} <= names


def test_the_thesis_preset_trains_the_impala_network_on_minimaps(run_main, tmp_path):
    run_main(
        main,
        "academy_counterattack_hard",
        *("--preset", "thesis", "--total-frames", 128, "--num-envs", 2, "--num-steps", 64),
        *("--eval-episodes", 0, "--run-dir", tmp_path / "run"),
    )
    weights = load_checkpoint(tmp_path / "run")["model"]
    assert sum(value.numel() for value in weights.values()) == 396_868


def test_ctrl_c_saves_and_ends_the_training(tmp_path):
    program = Path(sys.executable).with_name("fbrl-train")
    arguments = [SCENARIO, "--num-envs", "2", "--num-steps", "256", "--run-dir", "run"]
    process = subprocess.Popen(
        [program, *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )
    table = tmp_path / "run" / "metrics.csv"
    deadline = time.monotonic() + 120
    while not (table.exists() and len(rows(tmp_path / "run")) >= 2):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert errors.startswith("fbrl-train: saved and ended with exit code 130. Go on with: ")
    assert errors.endswith("fbrl-train --resume run\n")
    assert "Interrupted after" in output
    assert load_checkpoint(tmp_path / "run")["frames"] == int(rows(tmp_path / "run")[-1]["frames"])


BAD_USAGE = {
    "scenario": (["academy_empty_gaol"], "academy_empty_goal"),
    "reward": ([SCENARIO, "--reward", "analytic"], "analytics"),
    "preset": ([SCENARIO, "--preset", "theses"], "thesis"),
    "observation": ([SCENARIO, "--observation", "mini"], "minimap"),
    "no scenario": ([], "Scenario"),
    "unknown option": ([SCENARIO, "--gama", "0.9"], "--gamma"),
    "no number": ([SCENARIO, "--gamma", "high"], "'high'"),
    "out of range": ([SCENARIO, "--gamma", "1.5"], "gamma is 1.5; it must be in [0, 1]"),
    "no critic": ([SCENARIO, "--critic-coeff", "0"], "critic_coeff is 0.0"),
    "too many minibatches": ([SCENARIO, "--num-minibatches", "5000"], "at most 1024"),
    "no value": ([SCENARIO, "--preset"], "--preset"),
    "negative interval": (
        [SCENARIO, "--eval-interval", "-1"],
        "eval_interval is -1; it must be in [0, ",
    ),
    "no such device": ([SCENARIO, "--device", "tpu"], "'tpu'"),
    "no such density": ([SCENARIO, "--reward.density", "nowhere.npz"], "nowhere.npz"),
    "negative cap": (
        [SCENARIO, "--reward.episode-cap", "-1"],
        "episode_cap is -1.0; it must be a number",
    ),
    "useless cap": (
        [SCENARIO, "--reward", "potential", "--reward.episode-cap", "1"],
        "Unrecognized options: --reward.episode-cap",
    ),
    "useless transition": (
        [SCENARIO, "--reward", "scoring", "--reward.transition", "consecutive"],
        "Unrecognized options: --reward.transition",
    ),
    "one argument too many": ([SCENARIO, "again"], "Unrecognized options: again"),
    "useless density": (
        [SCENARIO, "--reward", "scoring", "--reward.density", "a"],
        "Unrecognized options: --reward.density",
    ),
}


@pytest.mark.parametrize("case", BAD_USAGE)
def test_bad_usage_is_answered_with_one_line_and_exit_code_2(case, run_main, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, expected = BAD_USAGE[case]
    printed = run_main(main, *arguments, code=2)
    assert printed.out == ""
    assert printed.err.startswith("fbrl-train: error: ")
    assert printed.err.count("\n") == 1
    assert expected in printed.err
    assert list(tmp_path.iterdir()) == []


def test_a_run_directory_may_have_brackets_in_its_name(run_program, tmp_path):
    arguments = [SCENARIO, *WITHOUT_EVALUATION, "--run-dir", "[/x] a[bold]b"]
    done = run_program("fbrl-train", *arguments)
    assert done.returncode == 0, done.stderr
    assert "'[/x] a[bold]b'" in done.stdout.splitlines()[-1]
    assert (tmp_path / "[/x] a[bold]b" / "metrics.csv").exists()


def test_a_used_run_directory_is_left_alone(run, run_program):
    run_dir, _ = run
    before = sorted(path.name for path in run_dir.iterdir())
    done = run_program("fbrl-train", SCENARIO, "--run-dir", run_dir)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "not empty" in done.stderr
    assert sorted(path.name for path in run_dir.iterdir()) == before


def test_the_bar_of_the_training_comes_back_after_an_evaluation():
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with TrainDisplay(console, preset_config("light", SCENARIO)) as display:
        for show, expected in (
            (lambda: display.metrics(4096, {"time/frames_per_second": 500.0}), "training"),
            (lambda: display.evaluation("current", 3, 50), "evaluating the current policy"),
            (lambda: display.metrics(8192, {"time/frames_per_second": 500.0}), "training"),
        ):
            show()
            assert [t.description for t in display._bar.tasks if t.visible] == [expected]


@pytest.mark.parametrize("program", ["fbrl-train", "fbrl-eval"])
def test_a_reader_of_the_help_that_has_gone_ends_it_without_a_word(program):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as output:
        line = [Path(sys.executable).with_name(program), "--help"]
        done = subprocess.run(line, stdout=output, stderr=subprocess.PIPE, text=True)
    # Some Pythons' argparse swallows the error, and then all is well.
    assert done.returncode in (0, 1)
    assert done.stderr == ""


def test_help_names_every_option_with_its_values_and_its_default(run_program):
    done = run_program("fbrl-train", "--help")
    assert done.returncode == 0
    text = " ".join(done.stdout.replace("\u2502", " ").split())
    for field in (*dataclasses.fields(TrainConfig), *dataclasses.fields(PPOConfig)):
        if field.name not in ("scenario", "ppo") and not field.name.endswith("_options"):
            assert f"--{field.name.replace('_', '-')}" in text
    assert "--reward analytics|potential|checkpoints|scoring|MODULE:CLASS" in text
    assert "--reward.transition possession|consecutive" in text
    assert "--network.hidden-sizes" in text
    assert "(default: 0.2)" in text
    assert "{None}" not in text
    thesis = run_program("fbrl-train", "11_vs_11_easy_stochastic", "--preset", "thesis", "--help")
    assert "minimap" in thesis.stdout
