"""The directory of a run: made for one training, and used by one process at a time."""

from __future__ import annotations

import contextlib
import fcntl
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from fbrl.config import ConfigError, TrainConfig

LOCK_NAME = ".lock"


def make_run_dir(config: TrainConfig) -> Path:
    """Makes the directory of a run.

    Raises:
        ConfigError: It has something in it already, or can't be made.
    """
    run_dir = config.run_dir
    if run_dir is None:
        now = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{config.reward}-{config.preset}-seed{config.seed}-{now}"
        run_dir = Path("runs") / config.scenario / name
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        occupied = any(run_dir.iterdir())
    except OSError as error:
        raise ConfigError(f"The run directory {run_dir} can't be made: {error}.") from error
    if occupied:
        raise ConfigError(f"The run directory {run_dir} is not empty: choose a new one.")
    return run_dir


def existing_run_dir(config: TrainConfig) -> Path:
    """The directory of a run that is to go on.

    Raises:
        ConfigError: None is given, or there is no such directory.
    """
    if config.run_dir is None or not config.run_dir.is_dir():
        raise ConfigError(f"There is no run at {config.run_dir}: no training can go on there.")
    return config.run_dir


@contextlib.contextmanager
def locked_run_dir(run_dir: Path) -> Iterator[None]:
    """Keeps other trainings out of a run's directory.

    The lock ends with the process, however that ends; the file stays.

    Raises:
        ConfigError: Another process is training there.
        OSError: The directory can't be written, or its file system knows no locks.
    """
    with (run_dir / LOCK_NAME).open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(
                f"The run directory {run_dir} is in use: another process is training there. Wait "
                "for its end, or end it with Ctrl-C or SIGTERM, which saves it."
            ) from error
        yield
