"""The points of a sweep: which trainings a grid asks for, how far they are, what they came to."""

from __future__ import annotations

import itertools
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table

from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.cli.train_options import parse_training
from fbrl.config import ConfigError, TrainConfig

OWN_OPTIONS = ("run-dir", "num-threads")
"""Options of fbrl-train that the sweep decides."""


@dataclass(frozen=True)
class Point:
    """One training of a sweep: its directory, and how fbrl-train begins it."""

    run_dir: Path
    arguments: tuple[str, ...]
    config: TrainConfig = field(compare=False)

    @property
    def log(self) -> Path:
        """What fbrl-train printed, beside the run's directory."""
        return self.run_dir.with_name(f"{self.run_dir.name}.output.log")

    def has_begun(self) -> bool:
        """Whether there is a checkpoint to go on from."""
        return any((self.run_dir / "checkpoints").glob("*.pt"))

    def is_finished(self) -> bool:
        """Whether the training, and the evaluation at its end, are done.

        Raises:
            ConfigError: The training that is there is another one than the grid asks for.
        """
        from fbrl.checkpoint import CheckpointError
        from fbrl.training.training_state import SavedTraining

        if not self.has_begun():
            return False
        try:
            return SavedTraining.load(self.run_dir, self.config).is_finished(self.config)
        except CheckpointError:
            return False
        except ConfigError as error:
            raise ConfigError(
                f"In {self.run_dir} is another training than the grid asks for: {error} Choose "
                "another directory for the runs, or remove this one."
            ) from error

    def frames_done(self) -> int:
        """Frames that it has learned from, as far as its log says."""
        try:
            return int(read_run_log(self.run_dir).frames[-1])
        except RunLogError:
            return 0


def read_grid(path: Path, runs: Path) -> list[Point]:
    """The points of a grid, each checked as fbrl-train checks its command line.

    Raises:
        ValueError: It is no grid, or two points would have the same directory.
        OSError: The file can't be read.
    """
    try:
        options = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is no YAML: {error}") from error
    grids = options.get("grids") if isinstance(options, dict) else None
    if grids is None:
        grids = {"": options}
    elif not isinstance(grids, dict) or set(options) != {"grids"}:
        raise ValueError(f"{path} has grids, and not only these, each with a name of its own.")
    points = [
        point
        for name, grid in grids.items()
        for point in _points(path, grid, runs, {"grid": name} if name else {})
    ]
    if not points:
        raise ValueError(f"{path} has an empty list, so no training at all.")
    if len({point.run_dir for point in points}) < len(points):
        raise ValueError(f"Two points of {path} would have the same directory.")
    return points


def _points(path: Path, options: Any, runs: Path, named: Mapping[str, str]) -> list[Point]:
    if not isinstance(options, dict) or "scenario" not in options:
        raise ValueError(f"{path} has no options of fbrl-train, with a scenario among them.")
    settings = options.pop("settings", {"": {}})
    if not (isinstance(settings, dict) and all(isinstance(one, dict) for one in settings.values())):
        raise ValueError(f"{path} has settings that are no options by names.")
    for name in OWN_OPTIONS:
        if any(name in chosen for chosen in (options, *settings.values())):
            raise ValueError(f"{path} has {name}, which the sweep itself sets: leave it out.")
    points = []
    for setting, own_options in settings.items():
        lists = {
            str(name): value if isinstance(value, list) else [value]
            for name, value in {**options, **own_options}.items()
        }
        varied = [name for name, values in lists.items() if len(values) > 1]
        place = {**named, "setting": setting} if setting else named
        for values in itertools.product(*lists.values()):
            chosen = dict(zip(lists, values, strict=True))
            run_dir = runs / directory_name({**place, **{name: chosen[name] for name in varied}})
            arguments = training_arguments(chosen)
            config = parse_training("fbrl-train", [*arguments, "--run-dir", str(run_dir)])
            points.append(Point(run_dir, arguments, config))
    return points


def directory_name(values: Mapping[str, Any]) -> str:
    """A directory's name for the values by which a point differs from the others."""
    parts = [f"{name}={value}" for name, value in values.items()]
    return re.sub(r"[^\w=.,+-]+", "_", ",".join(parts)) or "run"


def training_arguments(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The command line of fbrl-train, but for the directory."""
    arguments = [str(values["scenario"])]
    for name, value in values.items():
        if value is True or value is False:
            arguments.append(f"--{name}" if value else f"--no-{name}")
        elif name != "scenario":
            arguments += [f"--{name}", *map(str, value if isinstance(value, list) else [value])]
    return tuple(arguments)


def print_summary(points: Sequence[Point], failures: Mapping[Point, str]) -> None:
    """Prints a line for each training, how to draw all of them, and what went wrong, in words."""
    table = Table("run", "state", "frames", "goal difference", box=None, pad_edge=False)
    for point in points:
        state = "failed" if point in failures else "finished"
        table.add_row(
            point.run_dir.name, state, f"{point.frames_done():,}", latest_goal_difference(point)
        )
    # A terminal breaks a long line, and a file has no width: nothing is to be cut off.
    Console(width=1000, highlight=False, markup=False).print(table)
    print("Draw them with:", *plot_commands(points), sep="\n  ")
    for point, outcome in failures.items():
        print(f"{point.run_dir}: {outcome}")
    print(f"{len(points) - len(failures)} of {len(points)} trainings are finished.")
    if failures:
        print("The same command tries those that failed again.")


def latest_goal_difference(point: Point) -> str:
    """The goal difference of a run: of its last evaluation, else of its last training matches."""
    for kind, where in (("evaluation", "evaluation"), ("match", "training matches")):
        try:
            _, values = read_run_log(point.run_dir).curve(f"{kind}/goal_difference")
        except ValueError:  # no such log, or nothing of this kind in it
            continue
        if len(values):
            return f"{values[-1]:+.2f} ({where})"
    return ""


def plot_commands(points: Sequence[Point]) -> list[str]:
    """Commands that draw the sweep: curves of each scenario and, where it was evaluated, bars."""
    runs = shlex.quote(str(points[0].run_dir.parent))
    patterns = {point.config.scenario: _pattern(point) for point in points}
    commands = [
        f"fbrl-plot curves {runs}/{pattern}/ --out {scenario}.png"
        for scenario, pattern in patterns.items()
    ]
    if all(point.config.eval_episodes for point in points):
        commands.append(f"fbrl-plot bars {runs}/*/ --out goals.png")
    return commands


def _pattern(point: Point) -> str:
    """What the shell completes to the runs of a point's scenario."""
    chosen = f"scenario={point.config.scenario}"
    before, found, after = point.run_dir.name.partition(chosen)
    return f"{'*' if before else ''}{chosen}{',*' if after else ''}" if found else "*"
