"""Faults that are made for real: what a training does, and what is left of it."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import torch
from compared_runs import assert_same_run, logged_steps, table
from conftest import needs_engine
from tensordict import TensorDict

from fbrl.assembly import make_model
from fbrl.checkpoint import load_checkpoint
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.config_json import config_from_dict
from fbrl.density import AssistDensity
from fbrl.envs import FootballVectorEnv
from fbrl.envs.engine import load_gfootball
from fbrl.envs.matches import Matches
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.update import TrainingDivergedError, update
from fbrl.training import TrainListener, train, trainer
from fbrl.training.evaluator import Evaluator
from fbrl.training.run_checkpoints import TrainingNotSavedError
from fbrl.training.run_dir import RunDirLock, RunDirReplacedError
from fbrl.transforms import ScoringReward

SMALL = PPOConfig(total_frames=256, num_envs=2, num_steps=16, num_minibatches=2, num_epochs=1)
FRAMES = list(range(32, 257, 32))


CONFIG = TrainConfig(
    "academy_empty_goal",
    network_options={"hidden_sizes": (16,)},
    checkpoint_interval=32,
    eval_episodes=0,
    ppo=SMALL,
)


@pytest.fixture
def config(tmp_path):
    return dataclasses.replace(CONFIG, run_dir=tmp_path / "run")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The same training without a fault."""
    run_dir = tmp_path_factory.mktemp("undisturbed") / "run"
    train(dataclasses.replace(CONFIG, run_dir=run_dir))
    return run_dir


@contextlib.contextmanager
def small_files_only():
    """Restores the limit of this process to the size of its files, whatever a test sets."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def limit_files(size):
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))


def at_frames(actions, warned):
    """A listener that does something after an update, and keeps the warnings."""
    return TrainListener(
        on_metrics=lambda frames, metrics: actions.get(frames, lambda: None)(),
        on_warning=warned.append,
    )


def test_a_disk_that_is_full_for_a_while_costs_nothing(config, undisturbed):
    saved_while_full, warned = [], []

    def look():
        saved_while_full.append(load_checkpoint(config.run_dir)["frames"])

    with small_files_only():
        actions = {64: lambda: limit_files(1024), 160: look, 192: lambda: limit_files(-1)}
        result = train(config, at_frames(actions, warned))
    assert result.frames == 256
    # Saved after 32 frames, not after 64 to 160.
    assert saved_while_full == [32]
    assert_same_run(config.run_dir, undisturbed)
    assert logged_steps(config.run_dir) == logged_steps(undisturbed)
    failed = [line for line in warned if "can't be written ([Errno 27] File too large)" in line]
    assert [line.split(" can't")[0] for line in failed] == [
        "The checkpoint of 64 frames",
        "TensorBoard's events",
        "metrics.csv",
    ]
    assert "the last checkpoint, of 32 frames, is whole" in failed[0]
    assert sorted(set(warned) - set(failed)) == [
        "Checkpoints can be written again: the last checkpoint, of 192 frames, is whole.",
        "TensorBoard's events can be written again.",
        "metrics.csv can be written again.",
    ]


def test_a_disk_that_stays_full_leaves_the_last_good_checkpoint_to_go_on_from(config, undisturbed):
    not_saved = pytest.raises(
        TrainingNotSavedError,
        match=r"ended after 256 frames.*too large.*the last checkpoint, of 96 frames, is whole",
    )
    with small_files_only(), not_saved:
        train(config, at_frames({128: lambda: limit_files(1024)}, []))
    assert load_checkpoint(config.run_dir, on_warning=pytest.fail)["frames"] == 96
    train(config, resume=True)
    assert_same_run(config.run_dir, undisturbed)


TINY_DISK = """
set -e
until_there() { until grep -q "$1" out; do kill -0 $training; sleep 0.1; done; }
mkdir disk
mount -t tmpfs -o size=4m none disk
"$1" academy_empty_goal --num-envs 2 --num-steps 16 --total-frames 64000 \\
    --network.hidden-sizes 16 --num-minibatches 2 --checkpoint-interval 32 --eval-episodes 0 \\
    --num-threads 1 \\
    --device cpu --run-dir disk/run > out 2> err &
training=$!
trap 'kill -9 $training 2> /dev/null || true' EXIT
trap 'exit 1' TERM
until [ -e disk/run/metrics.csv ]; do
    kill -0 $training
    sleep 0.1
done
mount --bind disk/run disk/run
mount -o remount,bind,ro disk/run
until_there "The checkpoint of .* can't be written .*Read-only file system"
umount --lazy disk/run
until_there "Checkpoints can be written again"
cat /dev/zero > disk/filler || true
until_there "The checkpoint of .* can't be written .*No space left"
kill -TERM $training
wait $training || echo $? > code
cp -r disk/run kept
"""


@needs_engine
def test_a_read_only_and_then_a_full_disk_end_in_one_line_and_exit_code_1(tmp_path):
    own_mounts = ["unshare", "--map-root-user", "--mount"]
    if subprocess.run([*own_mounts, "true"], check=False, capture_output=True).returncode:
        pytest.skip("no file systems may be mounted here")
    program = Path(sys.executable).with_name("fbrl-train")
    done = subprocess.run(
        [*own_mounts, "timeout", "90", "sh", "-c", TINY_DISK, "sh", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "code").read_text() == "1\n"
    errors = (tmp_path / "err").read_text()
    assert errors.count("\n") == 1
    found = re.search(r"could not be saved .*last checkpoint, of ([\d,]+) frames, is who", errors)
    assert re.search(r"Go on with: .*fbrl-train --resume disk/run$", errors)
    saved = load_checkpoint(tmp_path / "kept", on_warning=pytest.fail)["frames"]
    assert saved == int(found[1].replace(",", ""))


def test_a_run_directory_that_is_deleted_is_made_anew(config, undisturbed):
    warned = []
    train(config, at_frames({96: lambda: shutil.rmtree(config.run_dir)}, warned))
    (line,) = (line for line in warned if "was deleted" in line)
    assert line.startswith(
        f"The run directory {config.run_dir} was deleted or emptied. It is made anew"
    )
    logged = [int(row["frames"]) for row in table(config.run_dir, "metrics.csv")]
    assert logged == FRAMES[3:]
    ended, other = load_checkpoint(config.run_dir), load_checkpoint(undisturbed)
    for name, value in ended["model"].items():
        assert torch.equal(value, other["model"][name]), name
    # It is a run like any other.
    longer = dataclasses.replace(config, ppo=dataclasses.replace(SMALL, total_frames=288))
    assert train(longer, resume=True).frames == 288


def test_a_run_directory_that_is_another_trainings_now_is_left_alone(config):
    locks = []

    def replace():
        shutil.rmtree(config.run_dir)
        config.run_dir.mkdir()
        locks.append(RunDirLock(config.run_dir))

    with pytest.raises(RunDirReplacedError, match="another training was begun there"):
        train(config, at_frames({96: replace}, []))
    assert [path.name for path in config.run_dir.iterdir()] == [".lock"]


def test_what_a_diverging_training_leaves_behind_makes_the_same_loss_again(config):
    # One step spoils the network, the second one is not taken.
    config = dataclasses.replace(config, ppo=dataclasses.replace(SMALL, learning_rate=1e30))
    with pytest.raises(TrainingDivergedError, match="Try a lower learning_rate") as raised:
        train(config)
    path = config.run_dir / "diverged.pt"
    assert f"led to it are in {path}; the last checkpoint, of 0 frames, is whole" in str(
        raised.value
    )
    assert load_checkpoint(config.run_dir, on_warning=pytest.fail)["frames"] == 0
    content = load_checkpoint(path)
    saved = config_from_dict(content["config"])
    model = make_model(saved, torch.device("cpu"))
    model.load_state_dict(content["model"])
    ppo = PPO(None, model, saved.ppo)
    minibatch = TensorDict(content["minibatch"], batch_size=[16])
    with pytest.raises(TrainingDivergedError, match=re.escape(content["message"])) as again:
        update(ppo.loss, ppo.optimizer, minibatch, saved.ppo.max_grad_norm)
    assert repr(again.value.losses) == repr(content["losses"])  # equal, NaNs too


# A match whose engine hangs or aborts in one episode, each time that this is played.
TRAP = """
import sys
from pathlib import Path
from fbrl.envs import FootballVectorEnv
from fbrl.envs.engine import load_gfootball
from fbrl.envs import FootballVectorEnv

fault, trap = sys.argv.pop(1), Path("trap")
steps, send_step = 0, FootballVectorEnv.send_step

def step_into_trap(self, matches, actions, *rows):
    global steps
    steps += len(matches)
    if not trap.exists() and steps > 200:
        trap.write_text(str(self.episodes[matches[0]][0]))
    if trap.exists():
        disturbance = load_gfootball().engine.Disturbance(fault, engine_seed=int(trap.read_text()))
        self.disturb(disturbance)
    return send_step(self, matches, actions, *rows)

FootballVectorEnv.send_step = step_into_trap
from fbrl.cli.train import main
main()
"""


def fall_into_trap(
    fault, *arguments, cwd, script=TRAP, stdout=subprocess.PIPE, stderr=subprocess.PIPE
):
    return subprocess.run(
        [sys.executable, "-c", script, fault, *arguments],
        cwd=cwd,
        stdout=stdout,
        stderr=stderr,
        text=True,
        timeout=300,
    )


COMMAND = [
    *("academy_empty_goal", "--num-envs", "2", "--num-steps", "32", "--num-minibatches", "2"),
    *("--network.hidden-sizes", "16", "--total-frames", "768", "--eval-episodes", "0"),
    *("--device", "cpu", "--hang-timeout", "1", "--checkpoint-interval", "128"),
    *("--run-dir", "run"),
]


@needs_engine
def test_an_engine_that_hangs_ends_the_process_with_everything_saved(tmp_path):
    run_dir = tmp_path / "run"
    done = fall_into_trap("hang", *COMMAND, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    seed = (tmp_path / "trap").read_text()
    hanging = rf"match [01] of academy_empty_goal \(engine seed {seed}, episode \d+\)"
    assert re.match(
        rf"fbrl-train: error: The engine hangs: {hanging} took more than 1 s\.", done.stderr
    )
    rows = table(run_dir, "metrics.csv")
    assert f"of {rows[-1]['frames']} frames, is whole. Go on with: " in done.stderr
    assert "match_collector.py" in (run_dir / "crash.txt").read_text()
    # The trap is still there, but other matches are begun.
    command = shlex.split(done.stderr.split("Go on with: ")[1])
    again = fall_into_trap("hang", *command[1:], cwd=tmp_path)
    assert (again.returncode, again.stderr) == (0, "")
    assert "The training had crashed, see run/crash-1.txt." in again.stdout
    assert [int(row["frames"]) for row in table(run_dir, "metrics.csv")] == list(range(64, 769, 64))
    assert not (run_dir / "crash.txt").exists()


UPDATE_DURING_THE_HANG = """
import itertools, time
from pathlib import Path
from fbrl.ppo import algorithm

update, calls = algorithm.update, itertools.count(1)

def late_update(*arguments):
    # Of the first batch's eight the last one, so that little is left to be done in time.
    is_last = next(calls) == 8
    while is_last and "hangs" not in Path("run/crash.txt").read_text():
        time.sleep(0.05)
    return update(*arguments)

algorithm.update = late_update
"""


@needs_engine
def test_a_hang_that_nobody_can_be_told_of_ends_the_process_after_the_update_in_hand(tmp_path):
    reader, closed_pipe = os.pipe()
    os.close(reader)
    command = "academy_empty_goal --num-envs 2 --num-steps 64 --num-minibatches 8 --num-epochs 1"
    options = (
        "--network.hidden-sizes 16 --eval-episodes 0 --device cpu --hang-timeout 2 --run-dir run"
    )
    done = fall_into_trap(
        "hang",
        *command.split(),
        *options.split(),
        "--collect-ahead",
        cwd=tmp_path,
        script=UPDATE_DURING_THE_HANG + TRAP,
        stderr=closed_pipe,
    )
    os.close(closed_pipe)
    assert done.returncode == 1
    # A match of the second batch hung before the last of the first one's 8 updates.
    checkpoint = load_checkpoint(tmp_path / "run")
    assert checkpoint["frames"] == 128
    assert {state["step"].item() for state in checkpoint["optimizer"]["state"].values()} == {8}


def test_a_batch_that_hangs_as_the_training_ends_is_noticed_too(config, monkeypatch):
    send_step, steps, codes = FootballVectorEnv.send_step, itertools.count(1), []

    def sleep_in_the_second_batch(self, *arguments):
        disturbance = load_gfootball().engine.Disturbance("sleep", seconds=4)
        # Two groups are sent for each of the 16 steps of a batch.
        self.disturb(disturbance if next(steps) == 2 * (16 + 9) else None)
        return send_step(self, *arguments)

    monkeypatch.setattr(FootballVectorEnv, "send_step", sleep_in_the_second_batch)
    monkeypatch.setattr(os, "_exit", codes.append)
    hangs = []
    listener = TrainListener(
        on_metrics=lambda frames, metrics: signal.raise_signal(signal.SIGTERM),
        on_hang=hangs.append,
    )
    config = dataclasses.replace(config, collect_ahead=True, hang_timeout=1)
    assert train(config, listener).interrupted
    assert codes == [1]
    assert "of 32 frames, is whole" in hangs[0]


def test_a_training_that_fails_as_it_begins_leaves_its_directory_free(config, monkeypatch):
    with monkeypatch.context() as fault:
        fault.setattr(trainer, "make_collector", MagicMock(side_effect=RuntimeError("no threads")))
        with pytest.raises(RuntimeError, match="no threads"):
            train(dataclasses.replace(config, reward_options={"density": "uniform"}))
    assert (config.run_dir / "config.json").exists()
    (config.run_dir / "checkpoints").mkdir()
    (config.run_dir / "checkpoints" / "last.pt.partial").touch()
    own = config.run_dir / "notes.txt"
    own.touch()
    with pytest.raises(ConfigError, match="is not empty"):
        train(config)
    own.unlink()
    assert train(config).frames == 256
    assert config_from_dict(json.loads((config.run_dir / "config.json").read_text())) == config
    kept = AssistDensity.load(config.run_dir / "density.npz")
    assert torch.equal(kept.end.grid, AssistDensity.default().end.grid)
    assert len(list(config.run_dir.glob("events*"))) == 1
    with pytest.raises(ConfigError, match="is not empty"):
        train(config)


def test_after_a_crash_evaluations_play_other_matches(config, monkeypatch):
    played, prepare = [], Matches.prepare

    def recording_prepare(self, match, seed, episode_number):
        played[-1].add(seed)
        prepare(self, match, seed, episode_number)

    monkeypatch.setattr(Matches, "prepare", recording_prepare)
    config = dataclasses.replace(config, eval_pictures=False)
    model = make_model(config, torch.device("cpu"))
    for crashes in (0, 1, 2):
        played.append(set())
        evaluator = Evaluator(config, ScoringReward(), pytest.fail, crashes)
        evaluator.play(model, 1, lambda done: None)
        evaluator.close()
    before, after_one, after_two = played
    assert before.isdisjoint(after_one | after_two)
    assert after_one.isdisjoint(after_two)


@needs_engine
def test_an_engine_that_aborts_leaves_a_run_that_goes_on_even_without_any_output(tmp_path):
    run_dir = tmp_path / "run"
    done = fall_into_trap("abort", *COMMAND, cwd=tmp_path)
    assert done.returncode < 0
    assert "Fatal Python error: Aborted" in (run_dir / "crash.txt").read_text()
    saved = load_checkpoint(run_dir, on_warning=pytest.fail)["frames"]
    assert saved >= int(table(run_dir, "metrics.csv")[-1]["frames"]) - 128
    with open("/dev/full", "w") as full:
        again = fall_into_trap("abort", "--resume", "run", cwd=tmp_path, stdout=full)
    assert (again.returncode, again.stderr) == (0, "")
    assert load_checkpoint(run_dir)["frames"] == 768
    assert load_checkpoint(run_dir)["crashes"] == 1
