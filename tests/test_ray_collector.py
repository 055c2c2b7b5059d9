"""Matches on the nodes of a real Ray cluster on this machine, of which some are killed."""

from __future__ import annotations

import dataclasses
import importlib
import os
import signal
import sys

import numpy as np
import psutil
import pytest
import ray
import torch
from conftest import REPOSITORY
from ray.cluster_utils import Cluster

from fbrl.analysis.run_log import read_run_log
from fbrl.assembly import make_model, make_training_reward
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train import main
from fbrl.cli.train_options import parse_resume, parse_training
from fbrl.collect import MatchCollector, ray_collector
from fbrl.collect.collector import MatchWorkersError
from fbrl.collect.ray_cluster import connected_to_ray, even_share
from fbrl.collect.ray_collector import RayMatchCollector
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs.engine import load_gfootball
from fbrl.envs.matches import Matches
from fbrl.training.trainer import TrainListener, train

CONFIG = TrainConfig(
    "academy_3_vs_1_with_keeper",
    network_options={"hidden_sizes": (16,)},
    device="cpu",
    collector="ray",
    num_workers=2,
    hang_timeout=4,
    checkpoint_interval=128,
    eval_episodes=0,
    ppo=PPOConfig(
        total_frames=512,
        num_envs=4,
        num_steps=16,
        frame_skip=2,
        num_minibatches=2,
        num_epochs=2,
    ),
)


@pytest.fixture(scope="module")
def cluster():
    """Three nodes of one CPU each, beside one that only keeps the books.

    A node that does not answer is given up after seconds instead of a minute.
    """
    health = {"health_check_period_ms": 500, "health_check_timeout_ms": 1000}
    cluster = Cluster(
        head_node_args={"num_cpus": 0, "include_dashboard": False, "_system_config": health},
        initialize_head=True,
    )
    for _ in range(3):
        cluster.add_node(num_cpus=1, wait=False)
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    yield cluster
    ray.shutdown()
    cluster.shutdown()


@pytest.fixture(scope="module")
def workers(cluster):
    """A collector with two workers, the model that plays in them, and its warnings."""
    warnings = []
    model = make_model(CONFIG, torch.device("cpu"))
    collector = RayMatchCollector(
        CONFIG,
        model.get_collection_policy(),
        make_training_reward(CONFIG),
        seed=1,
        timeout=4,
        on_restart=warnings.append,
    )
    yield collector, model, warnings
    collector.close()


def place_of(collector, number):
    """The process and the node of a worker."""
    where = collector._workers[number].__ray_call__.remote(
        lambda worker: (os.getpid(), ray.get_runtime_context().get_node_id())
    )
    return ray.get(where)


def matches_of_threads(num_envs, model, seed):
    collector = MatchCollector(
        CONFIG.scenario,
        model.get_collection_policy(),
        num_envs=num_envs,
        num_steps=CONFIG.ppo.num_steps,
        reward=make_training_reward(CONFIG),
        num_threads=1,
        frame_skip=CONFIG.ppo.frame_skip,
        num_groups=1,
        seed=seed,
    )
    torch.manual_seed(seed)
    batch = collector.collect().clone()
    collector.close()
    return batch


def shapes(batch):
    return {key: (entry.shape, entry.dtype) for key, entry in batch.items(True, True)}


def test_a_worker_plays_what_threads_play_with_its_seed(workers):
    collector, model, _ = workers
    collector.set_seed(5)
    batch = collector.collect()
    assert batch.batch_size == (4, 16)
    assert place_of(collector, 0)[1] != place_of(collector, 1)[1]
    random = np.random.default_rng(5)
    for part in batch.split(2):
        expected = matches_of_threads(2, model, seed=int(random.integers(2**31)))
        # But for what transforms remember from step to step, which nothing reads afterwards.
        part = part.exclude(("next", "play_memory"), "done", "terminated", "truncated")
        expected = expected.exclude("last_ball_carrier")
        assert shapes(part) == shapes(expected)
        assert (part == expected).all()
    assert not torch.equal(batch["action"][:2], batch["action"][2:])


def test_the_same_seed_has_the_same_batches(workers):
    collector, *_ = workers
    batches = []
    for seed in (3, 4, 3):
        collector.set_seed(seed)
        collector.reset()
        batches.append(collector.collect())
    assert (batches[0] == batches[2]).all()
    assert not torch.equal(batches[0]["action"], batches[1]["action"])


@pytest.mark.slow
def test_batches_outlive_an_engine_that_hangs_and_a_node_that_vanishes(workers, cluster):
    collector, model, warnings = workers
    with torch.no_grad():
        model.get_collection_policy().policy_head.bias[7] = 1e6
    assert (collector.collect()["action"] == 7).all()
    places = list(collector._places)

    def hang_in_the_next_step(worker):
        step = Matches.step

        def hang(self, matches, actions):
            self.native.disturb(load_gfootball().engine.Disturbance("hang"))
            step(self, matches, actions)

        Matches.step = hang

    ray.get(collector._workers[0].__ray_call__.remote(hang_in_the_next_step))
    process, node = place_of(collector, 1)
    raylet = psutil.Process(process).parent()
    vanished = [raylet, *raylet.children(recursive=True)]
    for one in vanished:
        one.suspend()
    batch = collector.collect()
    assert batch.batch_size == (4, 16)
    # The successors began with weights of their own, but did not play with them.
    assert (batch["action"] == 7).all()
    assert len(warnings) == 2
    assert f"Ray worker 0 ({places[0]}), which plays 2 matches" in warnings[0]
    assert "hangs in the engine: match " in warnings[0]
    assert "took more than 4 s; 2 matches have been lost so far" in warnings[0]
    assert "9 times more at most" in warnings[0]
    assert f"Ray worker 1 ({places[1]})" in warnings[1]
    assert collector.lost_matches == 4
    assert place_of(collector, 1)[1] != node
    for one in vanished:
        one.kill()
    cluster.remove_node(next(n for n in cluster.worker_nodes if n.node_id == node), False)
    cluster.add_node(num_cpus=1)


def newest_worker(cluster):
    workers = [
        process
        for node in cluster.worker_nodes
        for process in psutil.Process(node.all_processes["raylet"][0].process.pid).children()
        if process.cmdline() and process.cmdline()[0].startswith("ray::MatchCollector")
    ]
    return max(workers, key=psutil.Process.create_time)


@pytest.mark.slow
def test_a_training_outlives_lost_workers_until_there_are_too_many_and_goes_on_from_there(
    tmp_path, cluster, monkeypatch
):
    monkeypatch.setattr(ray_collector, "MAX_RESTARTS", 1)
    losses, warnings = [], []

    def lose_a_worker(*_):
        losses.append(newest_worker(cluster))
        # First it is only stopped; the kernel kills one when memory runs out.
        losses[-1].send_signal(signal.SIGKILL if losses[1:] else signal.SIGSTOP)

    def go_on(line, listener):
        return train(parse_resume("fbrl-train", ["--resume", *line]), listener, resume=True).frames

    run_dir = str(tmp_path / "run")
    ppo = dataclasses.replace(CONFIG.ppo, total_frames=128)
    config = dataclasses.replace(CONFIG, collector="threads", num_workers=None, ppo=ppo)
    train(dataclasses.replace(config, run_dir=tmp_path / "run"))
    listener = TrainListener(on_metrics=lose_a_worker, on_warning=warnings.append)
    on_ray = [run_dir, "--total-frames", "512", "--collector", "ray", "--num-workers", "1"]
    too_often = r"was lost \(Actor.* 8 matches have been lost so far. That was too often."
    with pytest.raises(MatchWorkersError, match=too_often):
        go_on(on_ray, listener)
    assert len(warnings) == 2
    assert "new ones begin" in warnings[0]
    assert f"(process {losses[0].pid} on node " in warnings[1]
    assert "has not answered for 4 s; 4 matches have been lost so far." in warnings[1]
    assert "It is replaced, 0 times more" in warnings[1]
    assert not losses[0].is_running()
    before = load_checkpoint(tmp_path / "run")
    assert before["frames"] == 384
    assert before["matches"] == []

    listener = TrainListener(on_warning=warnings.append)
    assert go_on([run_dir, "--collector", "threads"], listener) == 512
    assert "new ones begin" in warnings[2]
    assert list(read_run_log(tmp_path / "run").frames) == [128, 256, 384, 512]
    assert len(load_checkpoint(tmp_path / "run")["matches"]) == 4


def test_a_cluster_that_is_too_small_is_refused_and_leaves_nothing_behind(tmp_path, cluster):
    config = dataclasses.replace(CONFIG, num_workers=4, run_dir=tmp_path / "run")
    with pytest.raises(ConfigError, match="1, 1, 1 CPUs: no room for 4 workers with 1 each"):
        train(config)
    assert not config.run_dir.exists()


def test_a_sweep_whose_trainings_fit_on_no_node_is_refused(cluster, monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "experiments" / "sweep")
    sweep = importlib.import_module("run")
    sweep.check_room(1, 0.0)
    with pytest.raises(ConfigError, match=r"No node .* has room for a training with 2 CPUs and 0"):
        sweep.check_room(2, 0.0)
    for name in ("run", "grid"):
        del sys.modules[name]


def test_workers_divide_the_matches(capsys):
    assert [even_share(8, most) for most in (1, 2, 3, 7, 8, 100)] == [1, 2, 2, 4, 8, 8]
    assert (
        parse_training("fbrl-train", ["academy_corner", "--collector", "ray"]).num_workers is None
    )
    with pytest.raises(SystemExit) as ended:
        main(["academy_corner", "--collector", "ray", "--num-workers", "3"])
    assert ended.value.code == 2
    assert "num_workers is 3; to share 8 matches" in capsys.readouterr().err


def test_ray_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"pip install 'fbrl\[ray\]'"), connected_to_ray():
        pass


def test_a_cluster_that_does_not_answer_is_named(run_program, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "nowhere:1")
    ended = run_program("fbrl-train", "academy_empty_goal", "--collector", "ray")
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "The Ray cluster at RAY_ADDRESS=nowhere:1 can't be reached" in ended.stderr
