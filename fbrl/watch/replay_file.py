"""Recorded matches in a file: arrays in a ``.npz``, without pickle."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fbrl.checks import check_count
from fbrl.density import AssistDensity, PositionDensity
from fbrl.density.assist import DensityMetadata
from fbrl.envs.engine import BUILTIN_AI, MAX_SEED
from fbrl.envs.observation import OBSERVATION_SPACE
from fbrl.files.array_file import read_arrays
from fbrl.files.atomic_write import atomic_write
from fbrl.scenarios import LARGEST_FRAME_SKIP
from fbrl.watch.recording import RECORDED_KEYS, MatchRecording

FORMAT = "fbrl-matches"
FORMAT_VERSION = 2
"""Version 1 knows no frame skip."""

_LARGEST_CONTENT = 2**30
_FACTS = ("scenario", "engine_seed", "episode_number", "frame_skip")


class ReplayError(ValueError):
    """Raised for a file that holds no recorded matches, or damaged ones."""


def save_replay(
    path: str | os.PathLike[str],
    recordings: Sequence[MatchRecording],
    density: AssistDensity | None = None,
) -> None:
    """Writes matches, and the density of their reward, in one piece or not at all.

    Raises:
        OSError: The file can't be written.
    """
    matches: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for index, match in enumerate(recordings):
        entry = {name: getattr(match, name) for name in _FACTS}
        matches.append({**entry, "rewards": list(match.rewards)})
        arrays[f"{index}/actions"] = match.actions
        arrays |= {f"{index}/{key}": array for key, array in match.observations.items()}
        arrays |= {f"{index}/rewards/{part}": array for part, array in match.rewards.items()}
    header = {"format": FORMAT, "version": FORMAT_VERSION, "matches": matches, "density": None}
    if density is not None:
        metadata = density.metadata
        header["density"] = {
            "start": density.start.peak,
            "end": density.end.peak,
            "metadata": None if metadata is None else dataclasses.asdict(metadata),
        }
        arrays["density/start"] = density.start.grid.cpu().numpy()
        arrays["density/end"] = density.end.grid.cpu().numpy()
    # Through a file object: numpy would append ".npz" to a path without it.
    with atomic_write(Path(path)) as file:
        np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)


def load_replay(path: str | os.PathLike[str]) -> tuple[list[MatchRecording], AssistDensity | None]:
    """Reads what :func:`save_replay` wrote. Runs no code from the file.

    Returns:
        The matches, and the density of their reward if it has one.

    Raises:
        ReplayError: There is no such file, it is damaged, or it is of another kind or a newer
            version.
    """
    path = Path(path)
    if not path.is_file():
        raise ReplayError(f"There is no file {path}.")
    try:
        with path.open("rb") as file:
            arrays = read_arrays(file, _LARGEST_CONTENT)
        header = json.loads(str(arrays["header"]))
        version = header["version"] if header["format"] == FORMAT else None
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        reason = f"{type(error).__name__}: {error!s:.200}"
        raise ReplayError(f"{path} holds no recorded matches, or is damaged ({reason}).") from error
    if not isinstance(version, int):
        raise ReplayError(f"{path} holds no recorded matches.")
    if version > FORMAT_VERSION:
        raise ReplayError(
            f"{path} has format {version}, but this fbrl reads up to {FORMAT_VERSION}: upgrade "
            "fbrl."
        )
    try:
        matches = [_match(index, entry, arrays) for index, entry in enumerate(header["matches"])]
        if not matches:
            raise ValueError("no matches")
        return matches, _density(header["density"], arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ReplayError(f"{path} is damaged: {type(error).__name__}, {error}.") from error


def _match(index: int, entry: Mapping[str, Any], arrays: Mapping[str, Any]) -> MatchRecording:
    actions = arrays[f"{index}/actions"]
    steps = len(actions)
    _check(f"{index}/actions", actions, (steps,), np.dtype(np.int64), 0, BUILTIN_AI)
    if not steps:
        raise ValueError("a match without steps")
    observations = {key: arrays[f"{index}/{key}"] for key in RECORDED_KEYS}
    for key, array in observations.items():
        space: Any = OBSERVATION_SPACE[key]
        shape = (steps + 1, *space.shape)
        _check(f"{index}/{key}", array, shape, space.dtype, space.low, space.high)
    rewards = {str(part): arrays[f"{index}/rewards/{part}"] for part in entry["rewards"]}
    for part, array in rewards.items():
        name = f"{index}/rewards/{part}"
        _check(name, array, (steps,), np.dtype(np.float32), -np.inf, np.inf)
    if not rewards:
        raise ValueError("a match without rewards")
    scenario, seed, number, frame_skip = ({"frame_skip": 1, **entry}[name] for name in _FACTS)
    if not (isinstance(scenario, str) and isinstance(seed, int) and isinstance(number, int)):
        raise ValueError("scenario, seed or episode number are of the wrong type")
    check_count("frame_skip", frame_skip, at_most=LARGEST_FRAME_SKIP)
    if not (0 <= seed <= MAX_SEED and 0 <= number <= MAX_SEED):
        raise ValueError(f"seed {seed} or episode number {number} are out of range")
    return MatchRecording(scenario, seed, number, actions, observations, rewards, frame_skip)


def _check(
    name: str, array: np.ndarray, shape: tuple[int, ...], dtype: Any, low: Any, high: Any
) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(
            f"{name} is {array.dtype} of shape {array.shape}, not {dtype} of shape {shape}"
        )
    # Comparisons with NaN are false.
    if not ((array >= low) & (array <= high) & np.isfinite(array)).all():
        raise ValueError(f"{name} has values out of range")


def _density(entry: Mapping[str, Any] | None, arrays: Mapping[str, Any]) -> AssistDensity | None:
    if entry is None:
        return None
    start, end = (
        PositionDensity(torch.from_numpy(arrays[f"density/{name}"]), entry[name])
        for name in ("start", "end")
    )
    metadata = entry["metadata"]
    return AssistDensity(start, end, None if metadata is None else DensityMetadata(**metadata))
