"""Checkpoints: whole or not there, and nothing in them is executed."""

from __future__ import annotations

import errno
import os
import pickle
import zipfile

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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
    with pytest.raises(TypeError, match=r"can't hold .*, a float64"):
        save_checkpoint(checkpoint, frames=8, unreadable=np.float64(0.5))
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


def test_the_one_before_is_kept_and_the_latest_is_never_missing(checkpoint, monkeypatch):
    previous = checkpoint.with_name("previous.pt")
    seen = []

    def replace(self, target):
        os.replace(self, target)
        seen.append(load_checkpoint(checkpoint)["frames"])

    monkeypatch.setattr(type(checkpoint), "replace", replace)
    for frames in (8, 9):
        save_checkpoint(checkpoint, keep_as=previous, frames=frames)
        assert load_checkpoint(checkpoint)["frames"] == frames
        assert load_checkpoint(previous)["frames"] == frames - 1
    assert seen == [7, 8, 8, 9]
    assert sorted(path.name for path in checkpoint.parent.iterdir()) == ["last.pt", "previous.pt"]


def test_one_is_kept_after_a_crash_between_the_two_renames(checkpoint):
    previous = checkpoint.with_name("previous.pt")
    previous.hardlink_to(checkpoint)
    save_checkpoint(checkpoint, keep_as=previous, frames=8)
    assert (load_checkpoint(checkpoint)["frames"], load_checkpoint(previous)["frames"]) == (8, 7)
    assert sorted(path.name for path in checkpoint.parent.iterdir()) == ["last.pt", "previous.pt"]


def test_one_is_kept_where_there_are_no_hard_links(checkpoint, monkeypatch):
    def hardlink_to(self, target):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    previous = checkpoint.with_name("previous.pt")
    monkeypatch.setattr(type(checkpoint), "hardlink_to", hardlink_to)
    save_checkpoint(checkpoint, keep_as=previous, frames=8)
    assert (load_checkpoint(checkpoint)["frames"], load_checkpoint(previous)["frames"]) == (8, 7)


@pytest.mark.parametrize("damage", ["cut", "empty", "missing"])
def test_in_place_of_a_damaged_one_the_one_before_is_taken_with_one_line(checkpoint, damage):
    previous = checkpoint.with_name("previous.pt")
    save_checkpoint(checkpoint, keep_as=previous, frames=8)
    if damage == "missing":
        checkpoint.unlink()
    else:
        checkpoint.write_bytes(checkpoint.read_bytes()[:900] if damage == "cut" else b"")
    warned = []
    run_dir = checkpoint.parent.parent
    assert load_checkpoint(run_dir, on_warning=warned.append)["frames"] == 7
    assert len(warned) == 1
    assert "last.pt" in warned[0]
    assert f"{previous}" in warned[0]
    # Asked for by its name it is not replaced by another one.
    with pytest.raises(CheckpointError, match=r"last\.pt"):
        load_checkpoint(checkpoint)


def test_a_newer_one_is_refused_even_if_there_is_an_older_one(checkpoint):
    save_checkpoint(checkpoint, keep_as=checkpoint.with_name("previous.pt"), frames=8)
    torch.save({"format_version": FORMAT_VERSION + 1}, checkpoint)
    with pytest.raises(CheckpointError, match="upgrade fbrl"):
        load_checkpoint(checkpoint.parent.parent)


@pytest.mark.parametrize(
    "change",
    [
        {"frames": 8},
        {"frames": {7}},
        {"sha256": None},
        {"more": 1},
        {"model": {"weight": torch.tensor([0.0, 1.0, 2.5])}},
    ],
)
def test_another_content_than_the_saved_one_is_damaged(checkpoint, change):
    torch.save({**torch.load(checkpoint, weights_only=True), **change}, checkpoint)
    with pytest.raises(CheckpointError, match="its content is not what was saved"):
        load_checkpoint(checkpoint)


def test_the_first_format_is_still_read(checkpoint):
    torch.save({"format_version": 1, "frames": 5, "model": {}}, checkpoint)
    assert load_checkpoint(checkpoint)["frames"] == 5


CONTENTS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda values: st.lists(values) | st.dictionaries(st.text(), values),
    max_leaves=8,
)


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(content=CONTENTS, shape=st.lists(st.integers(0, 3), max_size=3))
def test_any_content_comes_back_as_it_was(tmp_path, content, shape):
    path = tmp_path / "any.pt"
    numbers = [torch.rand(shape).to(dtype) for dtype in (torch.float32, torch.bfloat16, torch.bool)]
    save_checkpoint(path, content=content, numbers=numbers)
    loaded = load_checkpoint(path)
    assert repr(loaded["content"]) == repr(content)
    for one, other in zip(numbers, loaded["numbers"], strict=True):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_damaged_file_is_refused_or_what_was_saved(checkpoint, data):
    whole = load_checkpoint(checkpoint)
    damaged = bytearray(checkpoint.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(damaged) - 1))
        damaged[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)) | st.just(len(damaged)))
    other = checkpoint.with_name("damaged.pt")
    other.write_bytes(damaged[:cut])
    try:
        content = load_checkpoint(other)
    except CheckpointError:
        return
    # Bytes that hold nothing, such as the padding, may change.
    assert {**content, "model": None} == {**whole, "model": None}
    assert torch.equal(content["model"]["weight"], whole["model"]["weight"])


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(content=st.binary(max_size=2000))
def test_any_bytes_are_refused(tmp_path, content):
    path = tmp_path / "garbage.pt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"garbage\.pt"):
        load_checkpoint(path)


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
