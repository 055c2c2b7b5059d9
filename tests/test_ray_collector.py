"""Matches on the nodes of a real Ray cluster on this machine, of which some are killed."""

from __future__ import annotations

import dataclasses
import os
import signal
import sys

import psutil
import pytest
import ray
import torch
from ray.cluster_utils import Cluster

from fbrl.agent import make_model, make_training_reward
from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train import main, parse
from fbrl.collect import make_collection_env, ray_collector
from fbrl.collect.ray_cluster import connected_to_ray, even_share
from fbrl.collect.ray_collector import RayMatchCollector
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs.process_vector_env import MatchWorkersError
from fbrl.ppo.algorithm import PPO
from fbrl.training.trainer import TrainListener, train

CONFIG = TrainConfig(
    "academy_3_vs_1_with_keeper",
    hidden_sizes=(16,),
    device="cpu",
    collector="ray",
    num_workers=2,
    checkpoint_interval=128,
    eval_episodes=0,
    ppo=PPOConfig(total_frames=512, num_envs=4, num_steps=32, num_minibatches=2, num_epochs=2),
)


@pytest.fixture(scope="module")
def cluster():
    """Three nodes of one CPU each, beside one that only keeps the books."""
    cluster = Cluster(
        head_node_args={"num_cpus": 0, "include_dashboard": False}, initialize_head=True
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


def matches_of_threads():
    env, bookkeeping = make_collection_env(
        CONFIG.scenario, num_envs=4, reward=make_training_reward(CONFIG), num_threads=1, seed=1
    )
    ppo = PPO(env, make_model(CONFIG, torch.device("cpu")), CONFIG.ppo, bookkeeping)
    batch = ppo.collect().clone()
    env.close()
    return batch


def shapes(batch):
    return {key: (entry.shape, entry.dtype) for key, entry in batch.items(True, True)}


def test_batches_are_like_those_of_threads(workers):
    collector, *_ = workers
    first = collector.collect()
    expected = matches_of_threads()
    assert first.batch_size == expected.batch_size
    # But for what transforms remember from step to step, which nothing reads afterwards.
    assert shapes(first.exclude(("next", "play_memory"))) == shapes(
        expected.exclude("last_ball_carrier")
    )
    assert place_of(collector, 0)[1] != place_of(collector, 1)[1]
    # Each worker has matches and random numbers of its own.
    assert not torch.equal(first["action"][:2], first["action"][2:])


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
def test_batches_outlive_a_worker_that_is_killed_and_a_node_that_is_lost(workers, cluster):
    collector, model, warnings = workers
    with torch.no_grad():
        model.get_collection_policy().policy_head.bias[7] = 1e6
    assert (collector.collect()["action"] == 7).all()
    os.kill(place_of(collector, 0)[0], signal.SIGKILL)
    batch = collector.collect()
    assert batch.batch_size == (4, 32)
    # The successor began with weights of its own, but did not play with them.
    assert (batch["action"] == 7).all()
    assert len(warnings) == 1
    assert "Ray worker 0, which plays 2 matches" in warnings[0]
    assert "9 times more at most" in warnings[0]
    node = place_of(collector, 1)[1]
    cluster.remove_node(next(n for n in cluster.worker_nodes if n.node_id == node))
    assert (collector.collect()["action"] == 7).all()
    assert len(warnings) == 2
    assert collector.lost_matches == 4
    assert place_of(collector, 1)[1] != node
    cluster.add_node(num_cpus=1)


def kill_a_worker():
    """As the kernel does it when memory runs out."""
    workers = [
        process
        for process in psutil.process_iter(["cmdline"])
        if process.info["cmdline"] and process.info["cmdline"][0].startswith("ray::MatchCollector")
    ]
    max(workers, key=psutil.Process.create_time).kill()


@pytest.mark.slow
def test_a_training_outlives_killed_workers_until_there_are_too_many_and_goes_on_from_there(
    tmp_path, cluster, monkeypatch
):
    monkeypatch.setattr(ray_collector, "MAX_RESTARTS", 1)
    config = dataclasses.replace(CONFIG, num_workers=1, run_dir=tmp_path / "run")
    warnings = []
    listener = TrainListener(on_metrics=lambda *_: kill_a_worker(), on_warning=warnings.append)
    with pytest.raises(MatchWorkersError, match="8 matches have been lost so far"):
        train(config, listener)
    assert len(warnings) == 1
    assert "4 matches have been lost so far. It is replaced, 0 times more" in warnings[0]
    before = load_checkpoint(config.run_dir)
    assert before["frames"] == 256
    assert before["matches"] == []

    longer = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, total_frames=384))
    listener = TrainListener(on_warning=warnings.append)
    assert train(longer, listener, resume=True).frames == 384
    assert len(warnings) == 2
    assert "new ones begin" in warnings[1]
    in_threads = dataclasses.replace(config, collector="threads", num_workers=None)
    assert train(in_threads, listener, resume=True).frames == 512
    assert len(warnings) == 3
    assert list(read_run_log(config.run_dir).frames) == [128, 256, 384, 512]
    assert len(load_checkpoint(config.run_dir)["matches"]) == 4


def test_a_cluster_that_is_too_small_is_refused_and_leaves_nothing_behind(tmp_path, cluster):
    config = dataclasses.replace(CONFIG, num_workers=4, run_dir=tmp_path / "run")
    with pytest.raises(ConfigError, match="1, 1, 1 CPUs: no room for 4 workers with 1 each"):
        train(config)
    assert not config.run_dir.exists()


def test_workers_divide_the_matches(capsys):
    assert [even_share(8, most) for most in (1, 2, 3, 7, 8, 100)] == [1, 2, 2, 4, 8, 8]
    assert parse(["academy_corner", "--collector", "ray"]).num_workers is None
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


def test_a_cluster_of_this_machine_alone_listens_to_it_alone(run_program, monkeypatch, tmp_path):
    monkeypatch.setenv("RAY_ADDRESS", "local")
    script = tmp_path / "listening.py"
    script.write_text(
        "import psutil, ray\n"
        "from fbrl.collect.ray_cluster import connected_to_ray\n"
        "with connected_to_ray(num_cpus=1):\n"
        "    ray.get(ray.remote(lambda: 1).remote())\n"
        "    for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:\n"
        "        for one in process.net_connections('inet'):\n"
        "            if one.status == 'LISTEN':\n"
        "                print(one.laddr.ip)\n"
    )
    ended = run_program("python", script)
    assert ended.returncode == 0, ended.stderr
    addresses = set(ended.stdout.split())
    assert addresses
    assert addresses <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}
