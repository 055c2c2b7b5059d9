"""The figures of the thesis's experiments, from the rows and points of the report's tables."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from grid import Point

from fbrl.analysis.run_log import GOAL_DIFFERENCE
from fbrl.cli.plot import main as plot
from fbrl.components import REWARDS
from fbrl.config import TrainConfig
from fbrl.config_json import config_to_dict
from fbrl.evaluation.comparison import Row
from fbrl.figures.files import save_figure
from fbrl.figures.style import new_figure, set_labels
from fbrl.files.csv_table import write_csv_table
from fbrl.presets import nearest_preset
from fbrl.run_files import CONFIG_NAME, FRAMES, METRICS_NAME
from fbrl.scenarios import SCENARIOS

FIGURES = {
    "figure_6_1": ("academy_3_vs_1_with_keeper", "academy_counterattack_easy",
                   "academy_counterattack_hard"),
    "figure_6_2": ("11_vs_11_stochastic",),
    "figure_6_3": ("11_vs_11_easy_stochastic",),
}  # fmt: skip
"""Those of the thesis, each drawn once for a preset, and the scenarios that they show."""


def label_of(config: TrainConfig) -> str:
    """What tells a configuration from others, in any scenario."""
    options = REWARDS.without_defaults(config.reward, config.reward_options)
    departures = (f"{name} {value}" for name, value in options.items())
    return ", ".join([config.reward, nearest_preset(config), *departures])


def uncontrolled(label: str) -> str:
    """The label of the same reward in the same preset with nothing changed about it."""
    return ", ".join(label.split(", ")[:2])


def draw_rewards(
    points: Sequence[Point], rows: Sequence[Row], curves: Sequence[Row], out: Path
) -> None:
    """The thesis's figures and the learning curves, once for each preset, without controls."""
    plain = [row for row in rows if row["configuration"] == uncontrolled(row["configuration"])]
    for preset in dict.fromkeys(row["preset"] for row in plain):
        own = [row for row in plain if row["preset"] == preset]
        for name, scenarios in FIGURES.items():
            if shown := [row for row in own if row["trained_on"] in scenarios]:
                draw_bars(shown, out / f"{name}_{preset}.png", "--reference", "thesis")
        for scenario in dict.fromkeys(row["trained_on"] for row in own):
            learned = {row["policy"] for row in own if row["trained_on"] == scenario}
            its = [point for point in points if point.run_dir.name in learned]
            draw_curves(its, curves, out / f"curves_{scenario}_{preset}.png")


def draw_controls(rows: Sequence[Row], out: Path) -> None:
    """Rewards whose controls have been trained, beside these, for each scenario."""
    for scenario in dict.fromkeys(row["trained_on"] for row in rows):
        own = [row for row in rows if row["trained_on"] == scenario]
        labels = {row["configuration"] for row in own}
        controlled = {uncontrolled(label) for label in labels if label != uncontrolled(label)}
        if controlled:
            its = [row for row in own if uncontrolled(row["configuration"]) in controlled]
            draw_bars(its, out / f"controls_{scenario}.png")


def draw_curves(points: Sequence[Point], curves: Sequence[Row], path: Path) -> None:
    """Draws the learning curves of one scenario, from logs made of the table."""
    with tempfile.TemporaryDirectory() as folder:
        logs = [Path(folder, point.run_dir.name) for point in points]
        for point, log in zip(points, logs, strict=True):
            log.mkdir()
            config = json.dumps(config_to_dict(point.config))
            (log / CONFIG_NAME).write_text(config, encoding="utf-8")
            own = [row for row in curves if row["policy"] == log.name]
            own = [{name: row[name] for name in (FRAMES, GOAL_DIFFERENCE)} for row in own]
            write_csv_table(log / METRICS_NAME, own)
        draw(["curves", *map(str, logs), "--out", str(path)])


def draw_bars(rows: Sequence[Row], path: Path, *options: str) -> None:
    """Draws what agents reached where they were trained."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder, "results.csv")
        write_csv_table(table, rows)
        draw(["bars", str(table), *options, "--out", str(path)])


def draw_generalisation(rows: Sequence[Row], out: Path) -> None:
    """A heat map of mean goal differences, trained on and played on, if any played elsewhere."""
    if all(row["scenario"] == row["trained_on"] for row in rows):
        return
    played = [name for name in SCENARIOS if any(row["scenario"] == name for row in rows)]
    agents = sorted({(row["trained_on"], row["configuration"]) for row in rows})
    means = np.full((len(agents), len(played)), np.nan)
    for i, agent in enumerate(agents):
        for j, scenario in enumerate(played):
            found = [
                row["goal_difference"]
                for row in rows
                if (row["trained_on"], row["configuration"]) == agent
                and (row["scenario"], row["mode"]) == (scenario, "sample")
            ]
            means[i, j] = np.mean(found) if found else np.nan
    figure, axes = new_figure(1.0 * len(played) + 5, 0.4 * len(agents) + 3)
    axes.grid(visible=False)
    image = axes.imshow(means, cmap="RdBu", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(len(played)), played, rotation=40, ha="right")
    axes.set_yticks(range(len(agents)), [f"{where}: {label}" for where, label in agents])
    for (i, j), value in np.ndenumerate(means):
        axes.text(j, i, f"{value:.2f}", ha="center", va="center")
    figure.colorbar(image, ax=axes, label="goal difference")
    set_labels(axes, "Trained on (rows), played on (columns)", "", "")
    save_figure(figure, out / "generalisation.png")


def draw(arguments: Sequence[str]) -> None:
    """Has fbrl-plot draw."""
    try:
        plot(arguments)
    except SystemExit as end:
        if end.code:
            raise
