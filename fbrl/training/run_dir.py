"""The directory of a run: made for one training, and used by one process at a time."""

from __future__ import annotations

import fcntl
import os
import re
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from fbrl.config import ConfigError, TrainConfig
from fbrl.presets import nearest_preset
from fbrl.run_files import LOCK_NAME

_BEFORE_THE_FIRST_CHECKPOINT = re.compile(
    r"\.lock|crash\.txt|events\.out\.tfevents\..*|checkpoints"
    r"|(config\.json|density\.npz)(\.partial)?|checkpoints/last\.pt\.partial"
)
"""What a training writes before there is anything to go on from."""


def make_run_dir(config: TrainConfig) -> Path:
    """Makes the directory of a run, or takes one in which a training failed as it began.

    Raises:
        ConfigError: It has something else in it already, or can't be made.
    """
    reward, preset = config.reward.replace(":", "."), nearest_preset(config)
    name = f"{reward}-{preset}-seed{config.seed}-{datetime.now():%Y%m%d-%H%M%S}"
    run_dir = config.run_dir or Path("runs") / config.scenario / name
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        _false_start(run_dir)
    except OSError as error:
        raise ConfigError(f"The run directory {run_dir} can't be made: {error}.") from error
    return run_dir


def remove_false_start(run_dir: Path) -> None:
    """Removes what a training left that failed before its first checkpoint, but for the lock.

    This process must hold the lock of the run's directory.

    Raises:
        ConfigError: It has something else in it.
        OSError: It can't be removed.
    """
    for path in _false_start(run_dir):
        if path.is_file() and path.name != LOCK_NAME:
            path.unlink()


def _false_start(run_dir: Path) -> list[Path]:
    """All that is in a directory, if it is nothing that anybody needs."""
    paths = [*run_dir.iterdir(), *run_dir.glob("checkpoints/*")]
    for path in paths:
        if not _BEFORE_THE_FIRST_CHECKPOINT.fullmatch(path.relative_to(run_dir).as_posix()):
            raise ConfigError(f"The run directory {run_dir} is not empty: choose a new one.")
    return paths


def existing_run_dir(config: TrainConfig) -> Path:
    """The directory of a run that is to go on.

    Raises:
        ConfigError: None is given, or there is no such directory.
    """
    if config.run_dir is None or not config.run_dir.is_dir():
        raise ConfigError(f"There is no run at {config.run_dir}: no training can go on there.")
    return config.run_dir


class RunDirReplacedError(RuntimeError):
    """Raised where another training was begun in a directory that was taken from this one."""


class RunDirLock:
    """Keeps other trainings out of a run's directory until it is closed, or the process ends.

    Raises:
        ConfigError: Another process is training there.
        OSError: The directory can't be written, or its file system knows no locks.
    """

    def __init__(self, run_dir: Path) -> None:
        self.run_dir = run_dir
        self._file = _locked_file(run_dir)

    def renew(self) -> None:
        """Makes the directory anew, and locks it, where it is gone.

        Raises:
            RunDirReplacedError: There is another one in its place.
            OSError: It can't be made or looked at.
        """
        try:
            found = (self.run_dir / LOCK_NAME).stat()
        except FileNotFoundError:
            self.run_dir.mkdir(parents=True, exist_ok=True)
            file = _locked_file(self.run_dir)
            self._file.close()
            self._file = file
            return
        if not os.path.samestat(found, os.fstat(self._file.fileno())):
            raise RunDirReplacedError(
                f"The run directory {self.run_dir} was deleted, and another training was begun "
                "there: this one ends, and leaves the other one's files alone."
            )

    def close(self) -> None:
        """Lets other trainings in; the file stays."""
        self._file.close()


def _locked_file(run_dir: Path) -> BinaryIO:
    file = (run_dir / LOCK_NAME).open("ab")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        if not isinstance(error, BlockingIOError):
            raise
        raise ConfigError(
            f"The run directory {run_dir} is in use: another process is training there. Wait "
            "for its end, or end it with Ctrl-C or SIGTERM, which saves it."
        ) from error
    return file
