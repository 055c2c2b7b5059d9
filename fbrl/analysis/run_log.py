"""What a run has logged, read back: its configuration, its metrics and its evaluations."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fbrl.checks import UnknownNameError, check_name
from fbrl.config import TrainConfig
from fbrl.config_json import config_from_dict
from fbrl.files.csv_table import as_number, read_csv_table
from fbrl.run_files import CONFIG_NAME, EVALUATIONS_NAME, FRAMES, METRICS_NAME

GOAL_DIFFERENCE = "match/goal_difference"

Columns = dict[str, NDArray[np.float64]]


class RunLogError(ValueError):
    """Raised for a directory that holds no run, or a run whose files are empty or damaged."""


@dataclass(frozen=True)
class RunLog:
    """The log of a training: where it was read from, and what was trained, and how."""

    run_dir: Path
    config: TrainConfig

    @functools.cached_property
    def metrics(self) -> Columns:
        """Each column of ``metrics.csv`` as float64 of shape (iterations,).

        ``frames`` are integers that rise strictly; the other names are those of
        :mod:`fbrl.monitor`. What was not logged in an iteration is NaN, as the results of matches
        are before the first has ended.

        Raises:
            RunLogError: The file is missing, damaged, or has no iteration yet.
        """
        path = self.run_dir / METRICS_NAME
        columns = _read_columns(path)
        frames = columns[FRAMES]
        if not len(frames):
            raise RunLogError(f"{path} has no iteration yet.")
        falls = np.flatnonzero(np.diff(frames) <= 0)
        if len(falls):
            before, after = frames[falls[0]], frames[falls[0] + 1]
            raise RunLogError(
                f"{path} is damaged: after {before:.0f} frames come {after:.0f}, where they can "
                "only rise."
            )
        return columns

    @functools.cached_property
    def evaluations(self) -> Columns:
        """Each column of ``evaluations.csv`` as float64 of shape (evaluations,).

        ``frames`` and the names ``evaluation/...`` of :mod:`fbrl.monitor`, the oldest first. Empty
        if nothing was evaluated.

        Raises:
            RunLogError: The file is damaged.
        """
        path = self.run_dir / EVALUATIONS_NAME
        return _read_columns(path) if path.exists() else {}

    @property
    def frames(self) -> NDArray[np.float64]:
        """Frames learned from at the end of each iteration, shape (iterations,)."""
        return self.metrics[FRAMES]

    def metric(self, name: str) -> NDArray[np.float64]:
        """A column of the metrics, such as ``match/goal_difference``, shape (iterations,).

        Raises:
            UnknownNameError: It was not logged; the message has the nearest name.
        """
        return self.metrics[self._check(name, self.metrics)]

    def curve(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frames and values of a column of the metrics or evaluations, where it has a value.

        Both have the shape (points,), and the frames rise strictly: of two evaluations at the same
        number of frames the later one counts.

        Raises:
            UnknownNameError: It was not logged; the message has the nearest name.
        """
        self._check(name, [*self.metrics, *self.evaluations])
        columns = self.metrics if name in self.metrics else self.evaluations
        has_value = ~np.isnan(columns[name])
        frames, values = columns[FRAMES][has_value], columns[name][has_value]
        frames, from_the_end = np.unique(frames[::-1], return_index=True)
        return frames, values[::-1][from_the_end]

    def _check(self, name: str, names: Iterable[str]) -> str:
        try:
            return check_name("metric", name, names)
        except UnknownNameError as error:
            raise UnknownNameError(f"{self.run_dir}: {error}") from error


def read_run_log(run_dir: Path) -> RunLog:
    """The log in a directory of ``fbrl-train``; tables are read when they are first asked for.

    Raises:
        RunLogError: There is no run, or its configuration is damaged.
    """
    path = run_dir / CONFIG_NAME
    try:
        config = config_from_dict(json.loads(path.read_text(encoding="utf-8")))
        config.check()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise RunLogError(
            f"There is no run at {run_dir}: it has no {CONFIG_NAME}. Give the directory that "
            "fbrl-train made."
        ) from error
    except OSError as error:
        raise RunLogError(f"{path} cannot be read ({error.strerror}).") from error
    except (ValueError, RecursionError) as error:  # of the JSON, and of the configuration
        raise RunLogError(f"{path} is damaged, or of another version of fbrl: {error}") from error
    return RunLog(run_dir, config)


def frames_until(
    frames: ArrayLike, values: ArrayLike, threshold: float, tolerance: float = 0.0
) -> int | None:
    """Frames until a threshold is reached and kept: how fast a training converges.

    The smallest logged number of frames at which the value is at least ``threshold`` and after
    which no value that was logged is below ``threshold - tolerance``, up to the end of the log.
    NaN, as before the first match, is below every threshold.

    With tolerance 0 one low value near the end moves the result there. The goal difference is a
    mean over 100 matches, with a standard error of up to 0.05 where a match brings one goal or
    none: a tolerance of 0.1 forgives the noise and sees a collapse.

    Args:
        frames: Frames at each entry of the log, rising, shape (iterations,).
        values: What was logged there, shape (iterations,).
        threshold: What is to be reached.
        tolerance: How far values may fall below it afterwards, at least 0.

    Returns:
        The number of frames, or None if the threshold was not reached or not kept.
    """
    values = np.asarray(values, dtype=np.float64)
    lost = np.flatnonzero(~(values >= threshold - tolerance))
    first = lost[-1] + 1 if len(lost) else 0
    reached = np.flatnonzero(values[first:] >= threshold)
    return int(np.asarray(frames)[first + reached[0]]) if len(reached) else None


def paper_goal_difference(log: RunLog, frames: int) -> float | None:
    """The goal difference as the environment's paper reports it (Kurach et al. 2020).

    That is the mean over the last 100 training matches that had ended at the last iteration at or
    before this number of frames, or of fewer where fewer had ended (see ``match/count``). They were
    played with sampled actions by policies that were still changing. None if the log ends before
    that number or no match had ended.

    Raises:
        UnknownNameError: The log has no goal difference.
    """
    values = log.metric(GOAL_DIFFERENCE)
    before = np.flatnonzero(log.frames <= frames)
    if log.frames[-1] < frames or not len(before) or np.isnan(values[before[-1]]):
        return None
    return float(values[before[-1]])


def _read_columns(path: Path) -> Columns:
    try:
        # Before the table: a training that writes on may make a torn last line whole meanwhile.
        is_whole = path.read_bytes().endswith(b"\n")
        table = read_csv_table(path)
    except FileNotFoundError as error:
        raise RunLogError(f"{path} is missing, so the run has logged nothing.") from error
    except OSError as error:
        raise RunLogError(f"{path} cannot be read ({error}).") from error
    except ValueError as error:
        raise RunLogError(str(error)) from error
    if not table.columns:
        raise RunLogError(f"{path} is empty: no iteration has been logged yet.")
    if FRAMES not in table.columns:
        raise RunLogError(f"{path} is damaged: its first line has no column {FRAMES}.")
    if table.rows and not is_whole:
        raise RunLogError(
            f"{path} is damaged: line {table.lines[-1]} is cut off. Without that line the rest can "
            "be used."
        )
    numbers: dict[str, list[float]] = {name: [] for name in table.columns}
    for line, row in zip(table.lines, table.rows, strict=True):
        for name, text in row.items():
            try:
                numbers[name].append(as_number(text))
            except ValueError as error:
                raise RunLogError(
                    f"{path} is damaged: line {line} has {text!r} as {name}, which is no number."
                ) from error
    columns = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
    frames = columns[FRAMES]
    odd = np.flatnonzero(~((frames >= 0) & (frames < 2**53) & (frames == np.floor(frames))))
    if len(odd):
        raise RunLogError(
            f"{path} is damaged: line {table.lines[odd[0]]} has {frames[odd[0]]} as {FRAMES}, "
            "which is no number of frames."
        )
    return columns
