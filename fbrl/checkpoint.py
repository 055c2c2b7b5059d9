"""Checkpoints: written in one piece or not at all, read without running anything in them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

FORMAT_VERSION = 1

CHECKPOINT_NAME = "checkpoints/last.pt"
"""Where a run keeps its latest checkpoint, relative to its directory."""


class CheckpointError(ValueError):
    """Raised for a file that is no checkpoint, is damaged, or is of a newer version."""


def save_checkpoint(path: Path, **content: Any) -> None:
    """Writes a checkpoint so that at any moment the old or the new one is whole.

    Args:
        path: File to write or replace; its directory is made.
        content: Tensors, numbers, strings, and lists and dictionaries of them.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".partial")
    try:
        with temporary.open("wb") as file:
            torch.save({"format_version": FORMAT_VERSION, **content}, file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> Mapping[str, Any]:
    """Reads a checkpoint.

    Args:
        path: A checkpoint, or the directory of a run.
        device: Where its tensors go.

    Raises:
        CheckpointError: There is none, it is damaged, or it is not of this format. Nothing in
            the file is ever executed.
    """
    file = path / CHECKPOINT_NAME if path.is_dir() else path
    if not file.is_file():
        raise CheckpointError(f"There is no checkpoint at {file}.")
    try:
        content = torch.load(file, map_location=device, weights_only=True)
    except Exception as error:  # a damaged file can make the reader raise anything
        raise CheckpointError(
            f"{file} is damaged or is no checkpoint of fbrl ({type(error).__name__})."
        ) from error
    version = content.get("format_version") if isinstance(content, dict) else None
    if not isinstance(version, int):
        raise CheckpointError(f"{file} is no checkpoint of fbrl: it has no format version.")
    if version > FORMAT_VERSION:
        raise CheckpointError(
            f"{file} has format {version}, but this fbrl reads up to {FORMAT_VERSION}: "
            "upgrade fbrl."
        )
    return content
