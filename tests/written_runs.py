"""Directories of runs with the tables that they are given, for tests that read runs."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from fbrl.assembly import make_model
from fbrl.checkpoint import save_checkpoint
from fbrl.config_json import config_to_dict, save_config
from fbrl.envs.actions import ACTION_NAMES
from fbrl.presets import preset_config

SCENARIO = "academy_3_vs_1_with_keeper"
GOALS = "match/goal_difference"
FINAL = tuple(f"evaluation/goal_difference{end}" for end in ("", "_low", "_high"))


def write_run(
    run_dir: Path,
    metrics: Mapping[str, Sequence[float | str]],
    final: tuple[float, float, float] | None = None,
    *,
    scenario: str = SCENARIO,
    preset: str = "light",
    ppo: Mapping[str, Any] | None = None,
    **changes: Any,
) -> Path:
    """Writes a run.

    Args:
        run_dir: Where to.
        metrics: Columns of ``metrics.csv``.
        final: Goal difference of the last evaluation and the ends of its interval.
        scenario: What was played.
        preset: What the other settings are those of.
        ppo: Hyperparameters that differ from it.
        changes: Other settings that differ from it.
    """
    config = preset_config(preset, scenario)
    ppo_config = dataclasses.replace(config.ppo, **(ppo or {}))
    run_dir.mkdir(parents=True)
    save_config(
        dataclasses.replace(config, ppo=ppo_config, run_dir=run_dir, **changes),
        run_dir / "config.json",
    )
    write_table(run_dir / "metrics.csv", metrics)
    if final is not None:
        rows = {name: [0.0, value] for name, value in zip(FINAL, final, strict=True)}
        write_table(run_dir / "evaluations.csv", {"frames": [0, 1000], **rows})
    return run_dir


def write_shooter(run_dir: Path) -> Path:
    """Writes a run of one checkpoint, whose agent nearly always shoots."""
    config = dataclasses.replace(
        preset_config("light", "academy_empty_goal_close"),
        network_options={"hidden_sizes": (8,)},
        seed=4,
    )
    model = make_model(config, torch.device("cpu"))
    with torch.no_grad():
        model.get_collection_policy().policy_head.bias[ACTION_NAMES.index("shot")] = 5.0
    path = run_dir / "checkpoints" / "last.pt"
    save_checkpoint(path, config=config_to_dict(config), frames=123, model=model.state_dict())
    return run_dir


def write_table(path: Path, columns: Mapping[str, Sequence[Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*columns.values(), strict=True))
    return path
