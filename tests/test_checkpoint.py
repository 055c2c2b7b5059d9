"""Checkpoints: whole or not there, and nothing in them is executed."""

from __future__ import annotations

import os
import pickle
import zipfile

import pytest
import torch

from fbrl.checkpoint import FORMAT_VERSION, CheckpointError, load_checkpoint, save_checkpoint


@pytest.fixture
def checkpoint(tmp_path):
    path = tmp_path / "checkpoints" / "last.pt"
    save_checkpoint(path, frames=7, model={"weight": torch.arange(3.0)}, config={"a": [1, "b"]})
    return path


def test_what_was_saved_is_loaded_from_the_file_or_its_run(checkpoint):
    for path in (checkpoint, checkpoint.parent.parent):
        content = load_checkpoint(path)
        assert content["frames"] == 7
        assert content["config"] == {"a": [1, "b"]}
        assert content["model"]["weight"].tolist() == [0.0, 1.0, 2.0]


def test_a_failed_save_leaves_the_old_checkpoint_and_nothing_else(checkpoint):
    with pytest.raises(Exception, match="pickle"):
        save_checkpoint(checkpoint, frames=8, unsavable=lambda: None)
    assert load_checkpoint(checkpoint)["frames"] == 7
    assert [path.name for path in checkpoint.parent.iterdir()] == ["last.pt"]


def test_saving_replaces_the_file_in_one_step(checkpoint, monkeypatch):
    seen = []

    def replace(self, target):
        # At this moment both are whole: the old one in place, the new one beside it.
        seen.append((load_checkpoint(checkpoint)["frames"], load_checkpoint(self)["frames"]))
        os.replace(self, target)

    monkeypatch.setattr(type(checkpoint), "replace", replace)
    save_checkpoint(checkpoint, frames=8)
    assert seen == [(7, 8)]
    assert load_checkpoint(checkpoint)["frames"] == 8


@pytest.mark.parametrize("size", [0, 10, 500])
def test_a_truncated_file_is_refused_by_name(checkpoint, size):
    checkpoint.write_bytes(checkpoint.read_bytes()[:size])
    with pytest.raises(CheckpointError, match=r"last\.pt is damaged"):
        load_checkpoint(checkpoint)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CheckpointError, match=r"no checkpoint at .*nowhere"):
        load_checkpoint(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match=r"no checkpoint at .*last\.pt"):
        load_checkpoint(tmp_path)


def test_a_file_of_a_newer_version_is_refused(checkpoint):
    torch.save({"format_version": FORMAT_VERSION + 1}, checkpoint)
    with pytest.raises(CheckpointError, match="upgrade fbrl"):
        load_checkpoint(checkpoint)


def test_another_programs_file_is_refused(checkpoint):
    torch.save(torch.zeros(3), checkpoint)
    with pytest.raises(CheckpointError, match="no format version"):
        load_checkpoint(checkpoint)


class Malicious:
    def __reduce__(self):
        return os.mkdir, (os.environ["FBRL_TEST_TARGET"],)


@pytest.mark.parametrize("as_archive", [True, False])
def test_a_malicious_pickle_is_not_executed(checkpoint, tmp_path, monkeypatch, as_archive):
    target = tmp_path / "executed"
    monkeypatch.setenv("FBRL_TEST_TARGET", str(target))
    if as_archive:
        torch.save({"format_version": 1, "model": Malicious()}, checkpoint)
        assert zipfile.is_zipfile(checkpoint)
    else:
        checkpoint.write_bytes(pickle.dumps(Malicious()))
    with pytest.raises(CheckpointError):
        load_checkpoint(checkpoint)
    assert not target.exists()
    # The file would really do harm if it were loaded the usual way.
    with checkpoint.open("rb") as file:
        _load_the_usual_way(file, as_archive)
    assert target.exists()


def _load_the_usual_way(file, as_archive):
    if as_archive:
        torch.load(file, weights_only=False)
    else:
        pickle.load(file)
