"""A configuration as JSON, as runs and checkpoints keep it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fbrl.config import ConfigError, PPOConfig, TrainConfig, check_types
from fbrl.files.atomic_write import atomic_write


def save_config(config: TrainConfig, path: Path) -> None:
    """Writes the configuration as JSON; the file is replaced in one piece."""
    with atomic_write(path) as file:
        file.write((json.dumps(config_to_dict(config), indent=2) + "\n").encode())


def config_to_dict(config: TrainConfig) -> dict[str, Any]:
    """The configuration in the types that JSON knows."""
    values = dataclasses.asdict(config)
    values["run_dir"] = None if config.run_dir is None else str(config.run_dir)
    values["hidden_sizes"] = list(config.hidden_sizes)
    values["logger"] = list(config.logger)
    return values


def config_from_dict(values: Mapping[str, Any]) -> TrainConfig:
    """The configuration that :func:`config_to_dict` made a dictionary of.

    Raises:
        ConfigError: A field is unknown or of another type, or the scenario is missing.
    """
    try:
        values = _without_former_options(values)
        ppo = PPOConfig(**values.get("ppo", {}))
        config = TrainConfig(**{**values, "ppo": ppo})
        run_dir = None if config.run_dir is None else Path(config.run_dir)
        hidden_sizes, logger = tuple(config.hidden_sizes), tuple(config.logger)
    except (TypeError, AttributeError) as error:
        raise ConfigError(f"This is no configuration of a training: {error}.") from error
    config = dataclasses.replace(config, run_dir=run_dir, hidden_sizes=hidden_sizes, logger=logger)
    check_types(config)
    check_types(config.ppo)
    return config


def _without_former_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """Leaves out how an older fbrl ran a training; none of it decided what was learned."""
    gone = ("compile", "cuda_graphs")
    current = {name: value for name, value in values.items() if name not in gone}
    if current.get("collector") == "processes":
        current.update(collector="threads", num_workers=None)
    return current
