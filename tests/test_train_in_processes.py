"""Trainings whose matches are played in worker processes."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import random
import signal

import pytest
from compared_runs import assert_same_run

from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train import main, parse
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs import process_vector_env
from fbrl.envs.process_vector_env import MatchWorkersError
from fbrl.training.trainer import TrainListener, train

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


def test_the_command_takes_the_options(capsys):
    assert parse(["academy_corner", "--collector", "processes"]).collector == "processes"
    with pytest.raises(SystemExit) as ended:
        main(["academy_empty_goal", "--num-workers", "2"])
    assert ended.value.code == 2
    assert "num_workers is only used with the collector processes" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="num_workers is 0"):
        dataclasses.replace(CONFIG, num_workers=0).check()
