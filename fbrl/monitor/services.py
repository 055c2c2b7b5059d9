"""Services that a training's metrics are sent to, beside the files in its directory.

Each is one of TorchRL's loggers. TensorBoard's events and the tables are written in any case, by
:mod:`fbrl.monitor.event_file` and :mod:`fbrl.monitor.table`, which outlive a full disk.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fbrl.checks import MissingExtraError
from fbrl.components import LOGGERS

if TYPE_CHECKING:
    from torchrl.record.loggers.common import Logger

_PROJECT = "fbrl"


class ServiceError(OSError):
    """Raised for a service that can't be logged to from the start."""


@dataclass(frozen=True)
class Service:
    """A service, and the run that it keeps there.

    Attributes:
        logger: What metrics and hyperparameters are handed to.
        run_id: The service's name of the run, by which a resumed training goes on with it.
        close: Ends the run.
    """

    logger: Logger
    run_id: str
    close: Callable[[], None]


def open_wandb(run_dir: Path, run_id: str | None) -> Service:
    """Opens Weights & Biases."""
    import wandb
    from torchrl.record.loggers.wandb import WandbLogger

    logger = WandbLogger(
        exp_name=run_dir.resolve().name,
        save_dir=str(run_dir),
        id=run_id,
        project=os.environ.get("WANDB_PROJECT", _PROJECT),
        log_env_packages=False,
        settings=wandb.Settings(console="off"),  # standard output stays as it is
    )
    return Service(logger, logger.experiment.id, logger.close)


def open_mlflow(run_dir: Path, run_id: str | None) -> Service:
    """Opens MLflow."""
    import mlflow
    import omegaconf  # noqa: F401 - MLFlowLogger.log_hparams imports it, whatever it is given
    from torchrl.record.loggers.mlflow import MLFlowLogger

    if run_id is not None:
        os.environ["MLFLOW_RUN_ID"] = run_id  # MLFlowLogger has no argument for it
    database = f"sqlite:///{run_dir.resolve() / 'mlflow.db'}"
    logger = MLFlowLogger(
        exp_name=os.environ.get("MLFLOW_EXPERIMENT_NAME", _PROJECT),
        tracking_uri=os.environ.get("MLFLOW_TRACKING_URI", database),
    )
    mlflow.set_tag("mlflow.runName", run_dir.resolve().name)
    return Service(logger, logger.experiment.info.run_id, mlflow.end_run)


def open_service(name: str, run_dir: Path, run_id: str | None = None) -> Service:
    """Opens a service of :data:`fbrl.components.LOGGERS` for a run, or for one that goes on there.

    Raises:
        UnknownNameError: There is no service of this name.
        MissingExtraError: Its package is not installed.
        ServiceError: It can't be reached, or refuses the login.
    """
    open_logger = LOGGERS.load(name)
    try:
        service = open_logger(run_dir, run_id)
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"Logs in {name}", [str(error.name)], name) from error
    except Exception as error:  # each has its own
        raise ServiceError(
            f"{name} can't be logged to ({error}). Train without it, or see its documentation for "
            "its address, its login and logging offline."
        ) from error
    if not isinstance(service, Service):
        raise ServiceError(f"The logger {name} returned {service!r:.80}; it must return a Service.")
    return service
