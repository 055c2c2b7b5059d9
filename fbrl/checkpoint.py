"""Checkpoints: written in one piece or not at all, read without running anything in them."""

from __future__ import annotations

import hashlib
import io
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

from fbrl.files.atomic_write import atomic_write
from fbrl.run_files import CHECKPOINT_NAME, PREVIOUS_NAME

FORMAT_VERSION = 2


class CheckpointError(ValueError):
    """Raised for a file that is no checkpoint, is damaged, or is of a newer version."""


class DamagedCheckpointError(CheckpointError):
    """Raised for a file that is missing or is not what was saved."""


def save_checkpoint(path: Path, *, keep_as: Path | None = None, **content: Any) -> None:
    """Writes a checkpoint so that at any moment the old or the new one is whole.

    The file is what ``torch.save`` writes: ``torch.load(path, weights_only=True)`` gives the
    content, with ``format_version`` and ``sha256``, a digest of all the rest.

    Args:
        path: File to write or replace; its directory is made.
        keep_as: Where the file that is replaced goes; by default it is deleted.
        content: Tensors, numbers, strings, and lists and dictionaries of them.

    Raises:
        TypeError: There is something else in it, which could not be read back.
        OSError: The file can't be written.
    """
    # On a full disk torch.save itself would raise a RuntimeError about its own archive.
    whole = io.BytesIO()
    header = {"format_version": FORMAT_VERSION, "sha256": _digest(content)}
    torch.save(header | content, whole)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, keep_as) as file:
        file.write(whole.getbuffer())


def load_checkpoint(
    path: Path,
    device: torch.device | str = "cpu",
    on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=3),
) -> dict[str, Any]:
    """Reads a checkpoint; nothing in the file is ever executed.

    Format 1, which had no digest and no state of the matches, is read too: ``config``, ``frames``
    and ``model`` have not changed since.

    Args:
        path: A checkpoint, or the directory of a run: its latest one, or where that is damaged
            the one before.
        device: Where its tensors go.
        on_warning: Called with one line if the one before had to be taken.

    Raises:
        CheckpointError: There is none, it is damaged, or it is not of this format.
    """
    if not path.is_dir():
        return _read(path, device)
    try:
        return _read(path / CHECKPOINT_NAME, device)
    except DamagedCheckpointError as error:
        previous = path / PREVIOUS_NAME
        if not previous.is_file():
            raise
        content = _read(previous, device)
        on_warning(f"{error} The checkpoint before it is taken instead, {previous}.")
        return content


def _read(file: Path, device: torch.device | str) -> dict[str, Any]:
    if not file.is_file():
        raise DamagedCheckpointError(f"There is no checkpoint at {file}.")
    try:
        with warnings.catch_warnings():
            # Of what a damaged file seems to be.
            warnings.simplefilter("ignore")
            content = torch.load(file, map_location=device, weights_only=True)
    except Exception as error:  # a damaged file can make the reader raise anything
        raise DamagedCheckpointError(
            f"{file} is damaged or is no checkpoint of fbrl ({type(error).__name__})."
        ) from error
    version = content.get("format_version") if isinstance(content, dict) else None
    if type(version) is not int or version < 1:
        raise DamagedCheckpointError(f"{file} is no checkpoint of fbrl: it has no format version.")
    if version > FORMAT_VERSION:
        raise CheckpointError(
            f"{file} has format {version}, but this fbrl reads up to {FORMAT_VERSION}: "
            "upgrade fbrl."
        )
    digest = content.pop("sha256", None)
    saved = {name: value for name, value in content.items() if name != "format_version"}
    is_whole = _is_plausible(content, file.stat().st_size)
    try:
        is_whole = is_whole and (version == 1 or digest == _digest(saved))
    except Exception:  # something in it is never saved
        is_whole = False
    if not is_whole:
        raise DamagedCheckpointError(f"{file} is damaged: its content is not what was saved.")
    return content


def _is_plausible(content: Mapping[str, Any], file_size: int) -> bool:
    """Whether a content is no larger than a file of this size can be that was saved here.

    A few bytes can stand for lists within lists that take years to walk through, for a list within
    itself, or for a tensor of terabytes that has one number in memory.
    """
    left: list[Any] = [content]
    entries = 0
    while left and entries <= file_size:  # each takes at least one byte
        value = left.pop()
        if isinstance(value, torch.Tensor) and value.numel() * value.element_size() > file_size:
            return False
        if isinstance(value, (Mapping, list, tuple)):
            entries += len(value)
            left += [*value.keys(), *value.values()] if isinstance(value, Mapping) else value
    return entries <= file_size


def _digest(content: Mapping[str, Any]) -> str:
    """The SHA-256 of a content as hexadecimal digits, whichever order its names are in."""
    digest: Any = hashlib.sha256()

    def add(value: Any) -> None:
        # Each value with its kind and size, so that no two contents are written alike.
        if isinstance(value, torch.Tensor):
            digest.update(f"tensor {value.dtype} {tuple(value.shape)} ".encode())
            flat = value.detach().cpu().contiguous().reshape(-1)
            digest.update(flat.view(torch.uint8).numpy())
        elif isinstance(value, Mapping):
            digest.update(f"mapping {len(value)} ".encode())
            for name in sorted(value, key=repr):
                add(name)
                add(value[name])
        elif isinstance(value, (list, tuple)):
            digest.update(f"sequence {len(value)} ".encode())
            for entry in value:
                add(entry)
        elif value is None or type(value) in (bool, int, float, str):
            text = repr(value).encode()
            digest.update(f"{len(text)} ".encode() + text)
        else:
            raise TypeError(f"A checkpoint can't hold {value!r}, a {type(value).__name__}.")

    add(content)
    return digest.hexdigest()
