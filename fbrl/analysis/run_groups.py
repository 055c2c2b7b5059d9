"""Runs grouped by what was trained, and the learning curves of their seeds pooled."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbrl.analysis.run_log import RunLog
from fbrl.analysis.seed_statistics import Array, mean_curve
from fbrl.components import COMPONENTS
from fbrl.config import HOW_IT_IS_RUN, TrainConfig
from fbrl.config_json import config_to_dict
from fbrl.presets import nearest_preset, preset_config

NOT_TRAINED = frozenset(
    {"seed", "run_dir", "eval_episodes", "eval_untrained", "eval_pictures", *HOW_IT_IS_RUN}
)
"""Fields of a configuration that may differ within a group: they leave what is learned alone."""

Settings = Mapping[str, Any]


class RunGroupError(ValueError):
    """Raised for runs that cannot be pooled."""


@dataclass(frozen=True)
class RunGroup:
    """Runs of one configuration, each with a seed of its own.

    Attributes:
        label: What tells the configuration from the others: "analytics, learning_rate 0.001".
        runs: At least one.
    """

    label: str
    runs: tuple[RunLog, ...]

    @property
    def config(self) -> TrainConfig:
        """That of the first run."""
        return self.runs[0].config


def group_runs(
    runs: Sequence[RunLog], always: Sequence[str] = (), frames: Sequence[int] | None = None
) -> list[RunGroup]:
    """Pools the runs whose configurations differ in the seed alone.

    So may what is in :data:`NOT_TRAINED`. A label has what differs between the configurations of a
    scenario; for what the presets merely bring along it has the preset's name.

    Args:
        runs: In any order; the groups come in the order of their first runs.
        always: Fields that a label always has.
        frames: Frames that each run was trained on, if that may be fewer than it was to be; these
            may not differ either.

    Raises:
        RunGroupError: A seed comes twice in a group.
    """
    members: dict[tuple[tuple[str, Any], ...], list[RunLog]] = {}
    for index, run in enumerate(runs):
        settings = _settings(run.config)
        if frames is not None and frames[index] < run.config.ppo.total_frames:
            settings["frames"] = frames[index]
        members.setdefault(tuple(settings.items()), []).append(run)
    for group in members.values():
        seen: dict[int, RunLog] = {}
        for run in group:
            other = seen.setdefault(run.config.seed, run)
            if other is not run:
                raise RunGroupError(
                    f"{other.run_dir} and {run.run_dir} have the same configuration and both seed "
                    f"{run.config.seed}, which can't count twice. Leave one of them out."
                )
    keys = list(map(dict, members))
    names = dict.fromkeys(["reward", "preset", *(name for key in keys for name in key)])
    shown = [name for name in names if name in always or _tells_apart(name, keys)]
    return [
        RunGroup(_label(key, shown), tuple(group))
        for key, group in zip(keys, members.values(), strict=True)
    ]


def single_runs(runs: Iterable[RunLog]) -> list[RunGroup]:
    """Each run as a group of its own, named by its directory."""
    return [RunGroup(run.run_dir.resolve().name, (run,)) for run in runs]


@dataclass(frozen=True)
class LearningCurve:
    """A metric over the frames of a training, the mean of the seeds.

    Attributes:
        label: What was trained.
        seeds: How many there are.
        frames: Shape (points,): those at which every seed has a value.
        mean: Over the seeds, shape (points,).
        low: Lower end of its 95 % interval, shape (points,); None for a single seed.
        high: Upper end, likewise.
    """

    label: str
    seeds: int
    frames: Array
    mean: Array
    low: Array | None
    high: Array | None


def learning_curve(group: RunGroup, metric: str, smooth: int = 1) -> LearningCurve:
    """Pools the seeds of a configuration.

    Args:
        group: The runs. Beyond the end of the shortest one nothing is pooled.
        metric: Any column of their metrics or evaluations.
        smooth: Each point becomes the mean of this many points of the same run up to it, fewer at
            the start.

    Raises:
        UnknownNameError: A run has not logged the metric.
        ValueError: There are no frames at which every run has a value.
    """
    curves = [run.curve(metric) for run in group.runs]
    frames = functools.reduce(np.intersect1d, [frames for frames, _ in curves])
    if not len(frames):
        raise ValueError(
            f"There are no frames at which {' and '.join(str(run.run_dir) for run in group.runs)} "
            f"have a value of {metric}, so there is nothing to draw."
        )
    values = [running_mean(values, smooth)[np.searchsorted(at, frames)] for at, values in curves]
    return LearningCurve(group.label, len(values), frames, *mean_curve(values))


def running_mean(values: Array, count: int) -> Array:
    """The mean of each value and those before it, ``count`` in all or as many as there are."""
    ends = range(1, len(values) + 1)
    return np.array([values[max(end - count, 0) : end].mean() for end in ends])


def _settings(config: TrainConfig) -> dict[str, Any]:
    values = config_to_dict(config)
    for kind in COMPONENTS:
        del values[f"{kind}_options"]
    for kind, registry, name, options in config.components():
        given = registry.without_defaults(name, options)
        values |= {f"{kind}.{option}": value for option, value in given.items()}
    ppo = values.pop("ppo")
    learned = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in {**values, **ppo}.items()
        if name not in NOT_TRAINED
    }
    # Each seed begins with the weights of a training of its own.
    learned["initial_weights"] = None if config.initial_weights is None else "given"
    return {"preset": nearest_preset(config), **learned}


def _tells_apart(name: str, keys: Sequence[Settings]) -> bool:
    for scenario in {key["scenario"] for key in keys}:
        # An option of a component has no entry where it is what it is anyway.
        values = [(key.get(name), key) for key in keys if key["scenario"] == scenario]
        differs = len({value for value, _ in values}) > 1
        by_nature = name in ("preset", "frames")
        if differs and (by_nature or any(v != _preset_value(name, key) for v, key in values)):
            return True
    return False


def _preset_value(name: str, key: Settings) -> Any:
    return _settings(preset_config(key["preset"], key["scenario"])).get(name)


def _label(key: Settings, shown: Sequence[str]) -> str:
    parts = [_part(name, key[name]) for name in shown if key.get(name) is not None]
    return ", ".join(parts) or f"{key['reward']} reward, preset {key['preset']}"


def _part(name: str, value: Any) -> str:
    if name == "reward":
        return str(value)
    if isinstance(value, tuple):
        value = " ".join(map(str, value))
    return f"{name} {value}"
