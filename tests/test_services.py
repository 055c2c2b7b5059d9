"""Metrics that are sent to services, by loggers that stand for them, and by their own if there."""

from __future__ import annotations

import sys
from functools import partial

import pytest
import torch
from test_monitor import PARTS, log, log_evaluation, make_batch

from fbrl.checkpoint import CheckpointError
from fbrl.checks import MissingExtraError, UnknownNameError
from fbrl.components import LOGGERS
from fbrl.config import TrainConfig
from fbrl.monitor import Monitor
from fbrl.monitor.services import Service, ServiceError, open_service

CONFIG = TrainConfig("academy_corner")
BATCH = make_batch([[1]], [[True]])


class Recorder:
    """Stands for TorchRL's logger of a service."""

    def __init__(self):
        self.told, self.settings, self.runs, self.closed = [], [], [], 0
        self.error = None

    def log_metrics(self, metrics, step):
        if self.error:
            raise self.error
        self.told.append((step, metrics))

    def log_hparams(self, settings):
        self.settings.append(settings)

    def close(self):
        self.closed += 1

    def open(self, run_dir, run_id):
        self.runs.append(run_id)
        return Service(self, run_id or "run 1", self.close)


@pytest.fixture
def recorder(monkeypatch):
    recorder = Recorder()
    monkeypatch.setattr(LOGGERS, "load", {"record": recorder.open}.__getitem__)
    return recorder


@pytest.fixture
def make_monitor(tmp_path):
    return partial(Monitor, tmp_path, CONFIG, PARTS, services=["record"])


def checkpoint_of(monitor, frames):
    return {"frames": frames, "evaluated_at": None, "monitor": monitor.state_dict()}


def test_a_service_is_told_what_the_files_are(recorder, make_monitor):
    monitor = make_monitor(pytest.fail)
    metrics = log(monitor, BATCH, 64)
    log_evaluation(monitor, 64)
    monitor.close()
    (settings,) = recorder.settings
    assert settings["ppo.gamma"] == 0.993
    (first, second) = recorder.told
    assert first == (64, metrics)
    assert (second[0], second[1]["evaluation/goal_difference"]) == (64, 0.75)
    assert recorder.closed == 1


def test_a_training_that_goes_on_goes_on_with_its_run_there(recorder, make_monitor):
    monitor = make_monitor(pytest.fail)
    log(monitor, BATCH, 64)
    resumed = make_monitor(pytest.fail, checkpoint_of(monitor, 64))
    log(resumed, BATCH, 128)
    assert recorder.runs == [None, "run 1"]
    assert [frames for frames, _ in recorder.told] == [64, 128]
    assert len(recorder.settings) == 1
    assert resumed.state_dict()["services"] == {"record": "run 1"}


def test_a_checkpoint_of_before_there_were_services_begins_a_run_there(recorder, make_monitor):
    checkpoint = checkpoint_of(make_monitor(pytest.fail), 64)
    del checkpoint["monitor"]["services"]
    make_monitor(pytest.fail, checkpoint)
    assert recorder.runs == [None, None]


@pytest.mark.parametrize("damage", [3, [1], {"record": torch.ones(1)}])
@pytest.mark.usefixtures("recorder")
def test_a_checkpoint_with_damaged_names_of_runs_is_refused(make_monitor, damage):
    checkpoint = checkpoint_of(make_monitor(pytest.fail), 64)
    checkpoint["monitor"]["services"] = damage
    with pytest.raises(CheckpointError):
        make_monitor(pytest.fail, checkpoint)


def test_a_service_that_is_gone_ends_no_training_and_is_given_up(recorder, make_monitor):
    warned = []
    monitor = make_monitor(warned.append)
    recorder.error = RuntimeError("no route to host")
    for frames in (64, 128):
        assert log(monitor, BATCH, frames)["ppo/entropy"] == 2.0
    recorder.error = None
    log(monitor, BATCH, 192)
    monitor.close()
    (line,) = warned
    assert line.startswith("record can't be logged to any more (no route to host).")
    assert "metrics.csv" in line
    assert recorder.told == []


def test_what_can_not_be_opened_is_named(monkeypatch, tmp_path):
    def refuse(run_dir, run_id):
        raise RuntimeError("no login")

    with monkeypatch.context() as patch:
        patch.setattr(LOGGERS, "load", {"wandb": refuse}.__getitem__)
        with pytest.raises(ServiceError, match=r"wandb can't be logged to \(no login\)"):
            open_service("wandb", tmp_path)
    with pytest.raises(UnknownNameError, match=r"no logger 'wandbd'.*mean wandb"):
        open_service("wandbd", tmp_path)


@pytest.mark.parametrize("name", LOGGERS.built_in)
def test_without_its_package_the_extra_is_named(monkeypatch, tmp_path, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=rf"pip install 'fbrl\[{name}\]'"):
        open_service(name, tmp_path)


def test_weights_and_biases_keeps_a_run_without_a_network(monkeypatch, tmp_path):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    for frames in (64, 128):
        checkpoint = None if frames == 64 else checkpoint_of(monitor, 64)  # noqa: F821
        monitor = Monitor(tmp_path, CONFIG, PARTS, pytest.fail, checkpoint, ["wandb"])
        log(monitor, BATCH, frames)
        monitor.close()
    runs = {path.stem for path in tmp_path.glob("wandb/*/run-*.wandb")}
    assert runs == {f"run-{monitor.state_dict()['services']['wandb']}"}


def test_mlflow_has_the_metrics_of_a_run_that_was_resumed(monkeypatch, tmp_path):
    mlflow = pytest.importorskip("mlflow")
    pytest.importorskip("omegaconf")
    for frames in (64, 128):
        checkpoint = None if frames == 64 else checkpoint_of(monitor, 64)  # noqa: F821
        monitor = Monitor(tmp_path, CONFIG, PARTS, pytest.fail, checkpoint, ["mlflow"])
        log(monitor, BATCH, frames)
        monitor.close()
    (run,) = mlflow.search_runs(search_all_experiments=True, output_format="list")
    assert run.info.run_id == monitor.state_dict()["services"]["mlflow"]
    assert run.info.run_name == tmp_path.name
    assert run.data.params["scenario"] == "academy_corner"
    steps = mlflow.MlflowClient().get_metric_history(run.info.run_id, "ppo/entropy")
    assert [entry.step for entry in steps] == [64, 128]
