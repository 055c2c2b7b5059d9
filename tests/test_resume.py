"""A training that stops, in whatever way, and goes on as if it had not."""

from __future__ import annotations

import dataclasses
import json
import random
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from compared_runs import assert_same_run, logged_steps, table
from conftest import needs_engine

from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.cli.train import main
from fbrl.cli.train_options import parse_resume, parse_training
from fbrl.collect import MatchCollector
from fbrl.config import CHANGEABLE_ON_RESUME, ConfigError, PPOConfig, TrainConfig
from fbrl.config_json import config_to_dict, save_config
from fbrl.training import TrainListener, train
from fbrl.training.run_dir import RunDirLock
from fbrl.training.training_state import SavedTraining

PPO = PPOConfig(total_frames=768, num_envs=2, num_steps=64, num_minibatches=2, num_epochs=2)
CONFIG = TrainConfig(
    "academy_3_vs_1_with_keeper",
    network_options={"hidden_sizes": (16,)},
    checkpoint_interval=256,
    checkpoint_keep_interval=256,
    eval_episodes=1,
    eval_interval=384,
    eval_untrained=True,
    eval_pictures=False,
    ppo=PPO,
)
CONFIGS = {
    "simple115": dataclasses.replace(
        CONFIG, midway_starts=0.5, ppo=dataclasses.replace(PPO, normalize_reward=True)
    ),
    # Two matches of one thread each and a small batch: the convolutions take most of the time.
    "minimap": dataclasses.replace(
        CONFIG,
        observation="minimap",
        reward="checkpoints",
        network_options={},
        eval_episodes=0,
        ppo=dataclasses.replace(PPO, total_frames=96, num_steps=8, num_epochs=1),
        checkpoint_keep_interval=64,
    ),
}


@pytest.fixture(scope="module", params=CONFIGS)
def whole_run(request, tmp_path_factory):
    """A training that nothing interrupts."""
    run_dir = tmp_path_factory.mktemp("whole") / "run"
    config = dataclasses.replace(CONFIGS[request.param], run_dir=run_dir)
    train(config)
    if config.eval_episodes:
        # Long enough that there are means of matches to go on with.
        assert int(table(run_dir, "metrics.csv")[-1]["match/count"]) >= 2
    return config


def test_a_run_that_stops_anywhere_and_goes_on_equals_one_that_does_not(
    whole_run, tmp_path, stop_after
):
    config = dataclasses.replace(whole_run, run_dir=tmp_path / "run")
    moments = random.Random(3)
    stops = 0
    resume = False
    # In the middle of batches and of evaluations, before the training and after it.
    most, least = (100, 10) if config.eval_episodes else (16, 4)
    while True:
        stop_after(moments.randint(1, most))
        result = train(config, resume=resume)
        if not result.interrupted:
            break
        stops, resume = stops + 1, True
        most = 2 * most if stops % 6 == 0 else most
        stop_after(0)
    assert stops >= least
    assert_same_run(config.run_dir, whole_run.run_dir)
    assert logged_steps(config.run_dir) == logged_steps(whole_run.run_dir)
    assert all(len(set(steps)) == len(steps) for steps in logged_steps(config.run_dir).values())


def test_going_on_from_any_kept_checkpoint_ends_the_same(whole_run, tmp_path):
    run_dir = tmp_path / "run"
    shutil.copytree(whole_run.run_dir, run_dir)
    kept = {int(path.stem) for path in run_dir.glob("checkpoints/[0-9]*.pt")}
    interval = whole_run.checkpoint_keep_interval
    assert kept == set(range(interval, whole_run.ppo.total_frames + 1, interval))
    for frames in kept:
        # As after a crash later on: the tables and the events reach further than the checkpoint.
        shutil.copy(run_dir / f"checkpoints/{frames}.pt", run_dir / "checkpoints" / "last.pt")
        train(dataclasses.replace(whole_run, run_dir=run_dir), resume=True)
        assert_same_run(run_dir, whole_run.run_dir)
        assert logged_steps(run_dir) == logged_steps(whole_run.run_dir)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A small run that has ended, to be copied by those who change it."""
    run_dir = tmp_path_factory.mktemp("finished") / "run"
    ppo = dataclasses.replace(PPO, total_frames=64, num_steps=16)
    config = dataclasses.replace(
        CONFIG, run_dir=run_dir, checkpoint_keep_interval=64, eval_episodes=0, ppo=ppo
    )
    train(config)
    return config


@pytest.fixture
def copied(finished, tmp_path):
    run_dir = tmp_path / "copy"
    shutil.copytree(finished.run_dir, run_dir)
    return dataclasses.replace(finished, run_dir=run_dir)


def longer(config, frames):
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, total_frames=frames))


def test_more_frames_go_on_from_the_end_with_the_new_schedule(copied):
    result = train(longer(copied, 128), resume=True)
    assert result.frames == 128
    rates = [float(row["ppo/learning_rate"]) for row in table(copied.run_dir, "metrics.csv")]
    # Before: falling to 0 at 64 frames; from there on: falling to 0 at 128.
    assert np.array(rates) / PPO.learning_rate == pytest.approx([1, 0.5, 0.5, 0.25])
    assert logged_steps(copied.run_dir)["ppo/entropy"] == [32, 64, 96, 128]


def test_a_finished_run_stays_as_it_is(copied):
    before = table(copied.run_dir, "metrics.csv")
    result = train(copied, resume=True)
    assert (result.frames, result.interrupted, result.trained) == (64, False, None)
    assert table(copied.run_dir, "metrics.csv") == before


def test_a_run_is_finished_although_its_last_batch_exceeded_the_frames(copied):
    within_the_last_batch = longer(copied, 63)
    assert SavedTraining.load(copied.run_dir, within_the_last_batch).is_finished(
        within_the_last_batch
    )
    assert train(within_the_last_batch, resume=True).frames == 64


def test_a_damaged_checkpoint_is_replaced_by_the_one_before_and_that_is_said(copied, finished):
    last, previous = (copied.run_dir / f"checkpoints/{name}.pt" for name in ("last", "previous"))
    shutil.copy(copied.run_dir / "checkpoints" / "64.pt", previous)
    last.write_bytes(last.read_bytes()[:-2000])
    warned = []
    train(copied, TrainListener(on_warning=warned.append), resume=True)
    assert len(warned) == 1
    assert re.search(r"last\.pt is damaged.* taken instead, .*previous\.pt", warned[0])
    assert_same_run(copied.run_dir, finished.run_dir)


def test_a_signal_just_after_a_batchs_last_step_does_not_part_matches_and_observation(
    finished, tmp_path, monkeypatch
):
    collect, batches = MatchCollector.collect, []

    def collect_and_signal(self, *arguments, **options):
        batches.append(collect(self, *arguments, **options))
        if len(batches) == 2:
            signal.raise_signal(signal.SIGTERM)
        return batches[-1]

    monkeypatch.setattr(MatchCollector, "collect", collect_and_signal)
    config = dataclasses.replace(finished, run_dir=tmp_path / "run")
    result = train(config)
    assert (result.interrupted, result.frames) == (True, 32)
    train(config, resume=True)
    assert_same_run(config.run_dir, finished.run_dir)


def test_two_trainings_never_share_a_directory(copied):
    lock = RunDirLock(copied.run_dir)
    with pytest.raises(ConfigError, match="is in use: another process is training there"):
        train(copied, resume=True)
    lock.close()
    train(copied, resume=True)


def test_only_a_training_of_the_same_kind_goes_on(copied):
    with pytest.raises(ConfigError, match="seed is 5, but the training had 0"):
        train(dataclasses.replace(copied, seed=5), resume=True)
    ppo = dataclasses.replace(copied.ppo, gamma=0.9)
    with pytest.raises(ConfigError, match=r"gamma is 0\.9, but the training had 0\.993"):
        train(dataclasses.replace(copied, ppo=ppo), resume=True)
    with pytest.raises(ConfigError, match=r"total_frames is 32, .* had 64 frames already"):
        train(longer(copied, 32), resume=True)
    with pytest.raises(ConfigError, match="There is no run at"):
        train(dataclasses.replace(copied, run_dir=copied.run_dir / "nowhere"), resume=True)


def test_a_checkpoint_of_the_first_format_is_refused(copied):
    last = copied.run_dir / "checkpoints" / "last.pt"
    content = load_checkpoint(last)
    content["format_version"] = 1
    torch.save({name: content[name] for name in ("format_version", "config", "frames")}, last)
    with pytest.raises(CheckpointError, match="can be evaluated and watched, but no training"):
        train(copied, resume=True)


ODD_CONTENTS = {
    "no matches": ({"matches": []}, "states of 0 matches for 2"),
    "matches of another kind": ({"matches": [1, 2]}, "not that of this training"),
    "no weights": ({"model": {}}, "not that of this training"),
    "no random numbers": ({"random_numbers": None}, "has None as random_numbers"),
    "odd random numbers": ({"random_numbers": {"cpu": 5, "cuda": None}}, "not that of this"),
    "an odd optimiser": ({"optimizer": {"state": 5, "param_groups": []}}, "not that of this"),
    "no optimiser": ({"optimizer": "Adam"}, "has 'Adam' as optimizer"),
    "frames below 0": ({"frames": -1}, "has -1 as frames"),
    "frames as a text": ({"frames": "64"}, "has '64' as frames"),
    "no next step": ({"next_step": {}}, "not that of this training"),
    "an odd next step": ({"next_step": {"simple115": torch.zeros(2, 5)}}, "not that of this"),
    "no means": ({"monitor": {}}, "no means of the last matches"),
    "odd evaluations": ({"evaluated_at": "64"}, "has '64' as evaluated_at"),
    "odd crashes": ({"crashes": "1"}, "has '1' as crashes"),
    "crashes below 0": ({"crashes": -1}, "has -1 as crashes"),
    "odd kept states": ({"kept_states": 5}, "has 5 as kept_states"),
}


@pytest.mark.parametrize("case", ODD_CONTENTS)
def test_a_whole_file_that_is_no_trainings_is_refused(case, copied):
    last = copied.run_dir / "checkpoints" / "last.pt"
    content = load_checkpoint(last)
    del content["format_version"]
    change, message = ODD_CONTENTS[case]
    save_checkpoint(last, **{**content, **change})
    with pytest.raises(CheckpointError, match=message):
        train(copied, resume=True)


def test_a_file_that_lacks_anything_is_refused_by_what_it_lacks(copied):
    last = copied.run_dir / "checkpoints" / "last.pt"
    content = load_checkpoint(last)
    del content["format_version"]
    for name in content.keys() - {"matches", "crashes", "kept_states", "reward_scale"}:
        save_checkpoint(last, **{key: value for key, value in content.items() if key != name})
        with pytest.raises(CheckpointError, match=f"has no {name}: no training can go on"):
            train(copied, resume=True)


def test_a_state_of_another_match_is_refused_before_the_engine_crashes_on_it(copied):
    last = copied.run_dir / "checkpoints" / "last.pt"
    content = load_checkpoint(last)
    del content["format_version"]
    content["matches"][0]["match"]["engine"] = content["matches"][1]["match"]["engine"]
    save_checkpoint(last, **content)
    with pytest.raises(CheckpointError, match="not that of a match of"):
        train(copied, resume=True)


BAD_USAGE = {
    "option": (["--gamma", "0.9"], "--gamma can't be given with --resume"),
    "preset": (["--preset=thesis"], "--preset can't be given"),
    "scenario": (["academy_corner"], "academy_corner can't be given"),
    "directory": (["--run-dir", "b"], "--run-dir can't be given"),
    "number": (["--total-frames", "many"], "--total-frames: invalid literal"),
    "range": (["--num-threads", "0"], "num_threads is 0"),
}


@pytest.mark.parametrize("case", BAD_USAGE)
def test_what_cannot_be_changed_is_refused_by_name(case, finished, capsys):
    arguments, expected = BAD_USAGE[case]
    with pytest.raises(SystemExit) as end:
        parse_resume("fbrl-train", ["--resume", str(finished.run_dir), *arguments])
    assert end.value.code == 2
    errors = capsys.readouterr().err
    assert expected in errors
    assert errors.count("\n") == 1


def test_the_rest_is_taken_from_the_run(finished):
    line = "--total-frames 640 --num-threads 1 --device cpu --eval-interval 7"
    config = parse_resume("fbrl-train", ["--resume", str(finished.run_dir), *line.split()])
    expected = dataclasses.replace(longer(finished, 640), num_threads=1, device="cpu")
    assert config == dataclasses.replace(expected, eval_interval=7)


CHANGES = {
    "total_frames": 640,
    "device": "cpu",
    "num_threads": 1,
    "num_groups": 3,
    "collector": "ray",
    "num_workers": 2,
    "logger": ("wandb", "mlflow"),
    "collect_ahead": True,
    "checkpoint_interval": 5,
    "checkpoint_keep_interval": 6,
    "eval_interval": 7,
    "hang_timeout": 8,
}


def as_option(name, value):
    option = f"--{name.replace('_', '-')}"
    values = value if isinstance(value, tuple) else (value,)
    return [option] if value is True else [option, *map(str, values)]


def test_whatever_may_change_can_be_given(finished):
    assert set(CHANGES) == set(CHANGEABLE_ON_RESUME)
    # Of these two only one at a time has a meaning.
    for other in ("collector", "collect_ahead"):
        changes = {name: value for name, value in CHANGES.items() if name != other}
        if other == "collector":
            del changes["num_workers"]
        line = [word for change in changes.items() for word in as_option(*change)]
        config = parse_resume("fbrl-train", ["--resume", str(finished.run_dir), *line])
        for name, value in changes.items():
            assert getattr(config.ppo if name == "total_frames" else config, name) == value, name


def test_the_number_of_workers_goes_with_the_place_of_the_matches(finished, tmp_path):
    on_ray = dataclasses.replace(finished, collector="ray", num_workers=2)
    save_config(on_ray, tmp_path / "config.json")
    config = parse_resume("fbrl-train", ["--resume", str(tmp_path), "--collector", "threads"])
    assert (config.collector, config.num_workers) == ("threads", None)


def test_a_run_of_before_goes_on_without_the_options_that_are_gone(finished, tmp_path):
    values = config_to_dict(finished)
    del values["num_groups"]
    values |= {"collector": "processes", "num_workers": 4, "compile": True, "cuda_graphs": False}
    (tmp_path / "config.json").write_text(json.dumps(values))
    config = parse_resume("fbrl-train", ["--resume", str(tmp_path)])
    assert config == dataclasses.replace(finished, run_dir=tmp_path)


def test_a_directory_without_a_run_is_named(run_program, tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "nowhere"):
        done = run_program("fbrl-train", "--resume", name)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"There is no run at {name}" in done.stderr
        assert done.stderr.count("\n") == 1


COMMAND = [
    "academy_3_vs_1_with_keeper",
    *(
        "--num-envs",
        "2",
        "--num-steps",
        "32",
        "--num-minibatches",
        "2",
        "--network.hidden-sizes",
        "16",
    ),
    *("--total-frames", "1280", "--checkpoint-interval", "64", "--eval-episodes", "0"),
    *("--num-threads", "1", "--device", "cpu", "--run-dir", "run"),
]


def start(*arguments, cwd):
    program = Path(sys.executable).with_name("fbrl-train")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([program, *arguments], cwd=cwd, **pipes)


def wait_for_rows(process, run_dir, number):
    deadline = time.monotonic() + 120
    while len(table(run_dir, "metrics.csv")) < number:
        assert time.monotonic() < deadline
        if process.poll() is not None:
            break
        time.sleep(0.01)


@needs_engine
def test_the_command_that_an_interrupted_run_prints_goes_on(tmp_path, run_main, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_dir = tmp_path / "run"
    process = start(*COMMAND, cwd=tmp_path)
    wait_for_rows(process, run_dir, 3)
    process.send_signal(signal.SIGSTOP)  # so that it's not at its end before the second begins
    second = run_main(main, "--resume", "run", code=2)
    assert (second.out, second.err.count("\n")) == ("", 1)
    assert "The run directory run is in use: another process is training there" in second.err
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGCONT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert len(table(run_dir, "metrics.csv")) < 20
    (command,) = re.findall(r"Go on with: (.*)$", errors, re.MULTILINE)
    done = subprocess.run(
        shlex.split(command), cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Going on after ")
    frames = list(range(64, 1281, 64))
    assert [int(row["frames"]) for row in table(run_dir, "metrics.csv")] == frames
    assert logged_steps(run_dir)["ppo/entropy"] == frames


@pytest.mark.slow
def test_a_run_that_is_killed_again_and_again_ends_like_one_that_is_not(tmp_path):
    whole = dataclasses.replace(parse_training("fbrl-train", COMMAND), run_dir=tmp_path / "whole")
    train(whole)
    run_dir = tmp_path / "run"
    moments = random.Random(1)
    process = start(*COMMAND, cwd=tmp_path)
    for kill in range(1, 4):
        wait_for_rows(process, run_dir, 5 * kill)
        time.sleep(moments.uniform(0, 0.2))
        process.kill()
        process.communicate()
        # Whenever it died, a whole checkpoint is there, one interval old at most.
        frames = load_checkpoint(run_dir, on_warning=pytest.fail)["frames"]
        assert frames >= int(table(run_dir, "metrics.csv")[-1]["frames"]) - 64
        process = start("--resume", "run", cwd=tmp_path)
    assert process.communicate(timeout=120)[1] == ""
    assert process.returncode == 0
    assert_same_run(run_dir, whole.run_dir)
    assert logged_steps(run_dir) == logged_steps(whole.run_dir)
