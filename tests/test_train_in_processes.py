"""Trainings whose matches are played in worker processes."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from compared_runs import assert_same_run, table
from conftest import needs_engine

from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train import main, parse
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs import process_vector_env
from fbrl.envs.process_vector_env import MatchWorkersError
from fbrl.training import TrainListener, train, trainer

CONFIG = TrainConfig(
    "academy_3_vs_1_with_keeper",
    hidden_sizes=(16,),
    collector="processes",
    checkpoint_interval=128,
    eval_episodes=0,
    ppo=PPOConfig(total_frames=512, num_envs=2, num_steps=64, num_minibatches=2, num_epochs=2),
)


@pytest.mark.slow
def test_processes_that_stop_at_ten_moments_train_as_threads_that_do_not(tmp_path, stop_after):
    threads = dataclasses.replace(CONFIG, collector="threads", run_dir=tmp_path / "threads")
    train(threads)
    processes = dataclasses.replace(CONFIG, run_dir=tmp_path / "processes")
    moments = random.Random(0)
    for stop in range(10):
        # Some of them in the first batch, which then begins anew; most further on.
        stop_after(moments.randint(1, 100))
        assert train(processes, resume=stop > 0).interrupted
    stop_after(0)
    # The last part in threads: either goes on with the other's checkpoints.
    assert train(dataclasses.replace(processes, collector="threads"), resume=True).frames == 512
    assert_same_run(processes.run_dir, threads.run_dir)


def kill_a_worker():
    worker = next(p for p in multiprocessing.active_children() if p.name.startswith("matches-"))
    os.kill(worker.pid, signal.SIGABRT)


def test_a_training_outlives_a_worker_that_aborts(tmp_path):
    warnings = []
    killed = []

    def on_metrics(frames, _):
        if not killed:
            kill_a_worker()
            killed.append(frames)

    config = dataclasses.replace(CONFIG, run_dir=tmp_path / "run")
    result = train(config, TrainListener(on_metrics=on_metrics, on_warning=warnings.append))
    assert result.frames == 512
    assert not result.interrupted
    assert len(warnings) == 1
    assert "was ended by SIGABRT; 1 matches have been lost" in warnings[0]
    assert list(read_run_log(config.run_dir).frames) == [128, 256, 384, 512]


def test_a_training_whose_workers_die_too_often_is_saved(tmp_path, monkeypatch):
    monkeypatch.setattr(process_vector_env, "MAX_RESTARTS", 1)
    config = dataclasses.replace(CONFIG, run_dir=tmp_path / "run")
    listener = TrainListener(on_metrics=lambda *_: kill_a_worker(), on_warning=lambda line: None)
    with pytest.raises(MatchWorkersError, match="too often"):
        train(config, listener)
    saved = load_checkpoint(config.run_dir)["frames"]
    assert saved == 256
    assert train(config, resume=True).frames == 512


@needs_engine
def test_a_signal_to_the_whole_group_saves_and_ends_the_training(tmp_path):
    program = Path(sys.executable).with_name("fbrl-train")
    options = ["--collector", "processes", "--num-envs", "2", "--num-steps", "16"]
    # Nearly all the time is that of updates, after which the workers are asked for their states.
    options += ["--num-epochs", "100", "--num-minibatches", "8"]
    options += ["--hidden-sizes", "16", "--device", "cpu", "--run-dir", "run"]
    process = subprocess.Popen(
        [program, "academy_3_vs_1_with_keeper", *options],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    give_up = time.monotonic() + 120
    while not table(tmp_path / "run", "metrics.csv") and time.monotonic() < give_up:
        time.sleep(0.05)
    time.sleep(0.3)  # into the second update
    os.killpg(process.pid, signal.SIGUSR1)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors.startswith("fbrl-train: saved and ended with exit code 130. Go on with: ")
    assert "lost" not in output
    checkpoint = load_checkpoint(tmp_path / "run")
    assert checkpoint["frames"] == int(table(tmp_path / "run", "metrics.csv")[-1]["frames"])
    assert len(checkpoint["matches"]) == 2


def test_a_checkpoint_has_no_matches_that_what_was_seen_does_not_fit(tmp_path, monkeypatch):
    learn = trainer.PPO.learn

    def learn_and_lose_a_worker(ppo, batch):
        losses = learn(ppo, batch)
        if ppo.frames == 256:
            kill_a_worker()
            signal.raise_signal(signal.SIGTERM)
        return losses

    monkeypatch.setattr(trainer.PPO, "learn", learn_and_lose_a_worker)
    config = dataclasses.replace(CONFIG, run_dir=tmp_path / "run")
    warnings = []
    listener = TrainListener(on_warning=warnings.append)
    assert train(config, listener).interrupted
    assert len(warnings) == 1
    checkpoint = load_checkpoint(config.run_dir)
    assert checkpoint["frames"] == 256
    assert (checkpoint["matches"], checkpoint["next_step"]) == ([], {})
    monkeypatch.undo()
    assert train(config, listener, resume=True).frames == 512
    assert len(warnings) == 2
    assert "of which one was just lost, are in no checkpoint: new ones begin" in warnings[1]


def test_the_command_takes_the_options(capsys):
    assert parse(["academy_corner", "--collector", "processes"]).collector == "processes"
    with pytest.raises(SystemExit) as ended:
        main(["academy_empty_goal", "--num-workers", "2"])
    assert ended.value.code == 2
    assert "num_workers is only used with the collector processes" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="num_workers is 0"):
        dataclasses.replace(CONFIG, num_workers=0).check()
