"""The monitor of a training: TensorBoard's events and the tables of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from torch.utils.tensorboard.summary import custom_scalars, hparams

from fbrl.checkpoint import CheckpointError
from fbrl.config import TrainConfig
from fbrl.config_json import with_flat_options
from fbrl.monitor.event_file import EventFile
from fbrl.monitor.recent_matches import RecentMatches
from fbrl.monitor.scalars import ACTION_TAGS, GOAL_DIFFERENCE_NAMES, chart_layout
from fbrl.monitor.services import open_service
from fbrl.monitor.table import Table, drop_rows
from fbrl.run_files import EVALUATIONS_NAME, FRAMES, METRICS_NAME

if TYPE_CHECKING:
    from fbrl.evaluation.evaluation import Evaluation

FRESH_FIGURES = ("goals_for", "goals_against", "length", "possession_share", "passes", "shots")
"""What else is logged of fresh matches, see :class:`fbrl.evaluation.evaluation.Evaluation`."""

_EVENTS = "TensorBoard's events"


class Monitor:
    """Writes what a training does into TensorBoard's events and, for pandas, into CSV tables.

    ``metrics.csv`` has a row for each iteration, ``evaluations.csv`` one for each evaluation, with
    the names of the scalars as columns. What can't be written is kept, after one warning, and
    written once that is possible again: a training outlives its log.

    Args:
        run_dir: The run's directory; it must exist.
        config: What is trained; its values are the run's hyperparameters in TensorBoard.
        reward_parts: Names of the reward's parts, as its transform gives them.
        on_warning: Called with one line when something can't be logged.
        checkpoint: What the training goes on from; what the files have past it is dropped.
        services: Names of :data:`fbrl.components.LOGGERS`, to which scalars and hyperparameters are
            sent, too. One that fails is told nothing more, after a warning.

    Raises:
        OSError: Nothing can be written into the directory to begin with, or a service can't be
            logged to.
        UnknownNameError: There is no such service.
        MissingExtraError: A service's package is not installed.
        CheckpointError: The checkpoint is not that of such a training.
    """

    def __init__(
        self,
        run_dir: Path,
        config: TrainConfig,
        reward_parts: tuple[str, ...],
        on_warning: Callable[[str], None],
        checkpoint: Mapping[str, Any] | None = None,
        services: Sequence[str] = (),
    ) -> None:
        self._run_dir = run_dir
        self._on_warning = on_warning
        self._failing: set[str] = set()
        self._tables: dict[str, Table] = {}
        self._recent = RecentMatches(reward_parts, config.ppo.frame_skip)
        self._latest: dict[str, float] = {}
        self._run_ids: dict[str, str] = {}
        self._events = EventFile(run_dir)
        if checkpoint:
            self._go_on(checkpoint)
        rewards = tuple(name for name in self._recent.names if name.startswith("reward/"))
        self._frame_skip = config.ppo.frame_skip
        settings = hyperparameters(config)
        experiment, start, _ = hparams(settings, dict.fromkeys(GOAL_DIFFERENCE_NAMES))
        for summary in (custom_scalars(chart_layout(rewards)), experiment, start):
            self._events.add(step=0, summary=summary)
        self._services = {
            name: open_service(name, run_dir, self._run_ids.get(name)) for name in services
        }
        for name, service in self._services.items():
            if name not in self._run_ids:
                self._tell(name, service.logger.log_hparams, settings)

    def close(self) -> None:
        """Ends the run at the services; the files need no end."""
        for name, service in self._services.items():
            self._tell(name, service.close)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs so that the log can go on."""
        return {
            "recent_matches": self._recent.state_dict(),
            "latest": self._latest,
            "services": {name: service.run_id for name, service in self._services.items()},
        }

    def _go_on(self, checkpoint: Mapping[str, Any]) -> None:
        frames, evaluated_at = checkpoint["frames"], checkpoint["evaluated_at"]
        try:
            state = checkpoint["monitor"]
            self._recent.load_state_dict(state["recent_matches"])
            self._latest = dict(state["latest"])
            # Those of before there were services have none.
            self._run_ids = dict(state.get("services", {}))
            if not all(isinstance(value, (int, float)) for value in self._latest.values()):
                raise ValueError("not all of the latest metrics are numbers")
            if not all(isinstance(run_id, str) for run_id in self._run_ids.values()):
                raise ValueError("not all of the services' names of the run are text")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CheckpointError(
                f"The checkpoint has no means of the last matches ({error!r:.200})."
            ) from error
        drop_rows(self._run_dir / METRICS_NAME, past=frames)
        last_evaluation = -1 if evaluated_at is None else evaluated_at
        drop_rows(self._run_dir / EVALUATIONS_NAME, past=last_evaluation)
        if evaluated_at == frames:
            self._events.add_restart(frames + 1)
        else:
            # There may be an evaluation at this very step, which will be done again.
            self._events.add_restart(frames)
            self._events.add_scalars(self._latest, frames)

    def log_iteration(
        self,
        frames: int,
        batch: TensorDictBase,
        losses: Mapping[str, float],
        collect_seconds: float,
        update_seconds: float,
        collect_cores: float,
    ) -> dict[str, float]:
        """Writes the metrics of an iteration and returns them by name.

        Until the first match has ended there are none of ``match``, ``reward`` and ``play``.

        Args:
            frames: Frames learned from so far, the x axis.
            batch: What was collected, shape (num_envs, num_steps).
            losses: What :meth:`fbrl.ppo.algorithm.PPO.learn` returned.
            collect_seconds: That collection took.
            update_seconds: That learning took.
            collect_cores: Cores that collection used, on average.
        """
        self._recent.add(batch)
        frames_here = batch.numel() * self._frame_skip
        counts = torch.bincount(batch.get("action").reshape(-1), minlength=len(ACTION_TAGS))
        of_iteration = {
            **dict(zip(ACTION_TAGS, (counts / batch.numel()).tolist(), strict=True)),
            **{f"ppo/{name}": value for name, value in losses.items()},
            "time/frames_per_second": frames_here / (collect_seconds + update_seconds),
            "time/collect_seconds": collect_seconds,
            "time/update_seconds": update_seconds,
            "time/collect_cores": collect_cores,
        }
        self._latest = {**self._recent.means(), **of_iteration}
        self._log(METRICS_NAME, [*self._recent.names, *of_iteration], self._latest, frames)
        return self._latest

    def log_evaluation(
        self, evaluation: Evaluation, frames: int, seconds: float, images: Mapping[str, bytes]
    ) -> None:
        """Writes the results of fresh matches, with pictures by name: PNG or GIF files."""
        goals = (evaluation.goal_difference, *evaluation.interval)
        metrics = {
            **dict(zip(GOAL_DIFFERENCE_NAMES, goals, strict=True)),
            **{f"evaluation/{figure}": evaluation.mean(figure) for figure in FRESH_FIGURES},
            "evaluation/matches": len(evaluation.goal_differences),
            "evaluation/seconds": seconds,
        }
        # The possession of matches in which nobody had the ball is not known.
        known = {name: value for name, value in metrics.items() if not math.isnan(value)}
        self._log(EVALUATIONS_NAME, list(metrics), known, frames)
        for name, encoded in images.items():
            self._write(_EVENTS, self._events.add_image, name, encoded, frames)

    def _log(
        self, table: str, columns: Sequence[str], metrics: Mapping[str, float], frames: int
    ) -> None:
        self._write(_EVENTS, self._events.add_scalars, metrics, frames)
        for name, service in self._services.items():
            self._tell(name, service.logger.log_metrics, dict(metrics), frames)
        if table not in self._tables:
            self._tables[table] = Table(self._run_dir / table, [FRAMES, *columns])
        self._write(table, self._tables[table].append, {FRAMES: frames, **metrics})

    def _tell(self, service: str, tell: Callable[..., object], *arguments: Any) -> None:
        # A service that is gone may take minutes to say so, each time.
        if service in self._failing:
            return
        try:
            tell(*arguments)
        except Exception as error:  # each service has its own
            self._failing.add(service)
            self._on_warning(
                f"{service} can't be logged to any more ({error}). The training goes on; what it "
                f"lacks is in {METRICS_NAME} and {EVALUATIONS_NAME}."
            )

    def _write(self, what: str, write: Callable[..., None], *arguments: Any) -> None:
        try:
            write(*arguments)
        except OSError as error:
            if what not in self._failing:
                self._failing.add(what)
                self._on_warning(
                    f"{what} can't be written ({error}). The training goes on; what is missing is "
                    "written once that is possible."
                )
        else:
            if what in self._failing:
                self._failing.remove(what)
                self._on_warning(f"{what} can be written again.")


def hyperparameters(config: TrainConfig) -> dict[str, float | str]:
    """The configuration without its directory as flat names, such as ``reward.weight``."""
    values = with_flat_options(config)
    del values["run_dir"]
    values |= {f"ppo.{name}": value for name, value in values.pop("ppo").items()}
    return {name: _number_or_text(value) for name, value in values.items()}


def _number_or_text(value: Any) -> float | str:
    if isinstance(value, (list, tuple)):
        return " ".join(map(str, value))
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number else str(value)
