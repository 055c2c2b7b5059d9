"""Faults of a Ray cluster that are made for real: what a training on it does, and what is left."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.checkpoint import load_checkpoint

OPTIONS = shlex.split(
    "academy_3_vs_1_with_keeper --collector ray --num-workers 1 --num-threads 1 --num-envs 2 "
    "--num-steps 32 --num-minibatches 2 --network.hidden-sizes 16 --device cpu "
    "--checkpoint-interval 64 --eval-episodes 0 --total-frames 1000000 --run-dir run"
)

SOON = """
import sys
from fbrl.collect import ray_cluster
from fbrl.cli.train import main
ray_cluster.HEAD_TIMEOUT = 3
main(sys.argv[1:])
"""
"""fbrl-train, which does not wait for the head of the cluster as long."""


@pytest.fixture
def start(tmp_path):
    """Starts a training as a user would, and waits until its matches are played."""
    started = []

    def start(*program):
        process = subprocess.Popen(
            [*program, *OPTIONS],
            cwd=tmp_path,
            env={**os.environ, "RAY_ADDRESS": "local", "FBRL_TCMALLOC": "0"},
            stderr=(tmp_path / "errors").open("w"),
            stdout=subprocess.DEVNULL,
            # Ctrl-C in a terminal goes to all of a group.
            start_new_session=True,
        )
        started.append(process)
        wait_until(lambda: frames(tmp_path / "run") or process.poll() is not None)
        assert process.poll() is None, (tmp_path / "errors").read_text()
        return process

    yield start
    for process in started:
        process.kill()


def frames(run_dir):
    try:
        return int(read_run_log(run_dir).frames[-1])
    except RunLogError:
        return 0


def wait_until(condition, seconds=300):
    give_up = time.monotonic() + seconds
    while not condition() and time.monotonic() < give_up:
        time.sleep(0.1)
    assert condition()


@pytest.mark.slow
def test_a_cluster_of_its_own_is_private_and_ends_on_ctrl_c_with_the_training_saved(
    start, tmp_path
):
    training = start(Path(sys.executable).with_name("fbrl-train"))
    own = psutil.Process(training.pid).children(recursive=True)
    assert any(process.cmdline()[0].startswith("ray::MatchCollector") for process in own)
    listening = {
        connection.laddr.ip
        for process in [psutil.Process(training.pid), *own]
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    }
    assert listening
    assert listening <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}
    os.killpg(training.pid, signal.SIGINT)
    assert training.wait(30) == 130
    errors = (tmp_path / "errors").read_text()
    # Before it come Ray's own lines.
    assert re.search(
        "fbrl-train: saved .* 130. Go on with: .*fbrl-train --resume run$", errors.strip()
    )
    saved = load_checkpoint(tmp_path / "run", on_warning=pytest.fail)["frames"]
    assert saved == frames(tmp_path / "run")
    psutil.wait_procs(own, timeout=10)
    assert not [process for process in own if process.is_running()]


@pytest.mark.slow
def test_a_training_whose_head_is_lost_is_saved_and_ends_with_what_to_do(start, tmp_path):
    training = start(sys.executable, "-c", SOON)
    (keeper,) = (
        process
        for process in psutil.Process(training.pid).children(recursive=True)
        if "gcs_server" in process.name()
    )
    keeper.kill()
    assert training.wait(60) == 1
    errors = (tmp_path / "errors").read_text()
    assert re.search(r"The head of the Ray cluster at [\d.]+:\d+ has not answered for 3 s", errors)
    assert "start it again with ray start" in errors
    assert errors.rstrip().endswith("fbrl-train --resume run")
    saved = load_checkpoint(tmp_path / "run", on_warning=pytest.fail)["frames"]
    assert saved == frames(tmp_path / "run")
