"""A configuration as JSON, as runs and checkpoints keep it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fbrl.components import COMPONENTS, PICTURES
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.files.atomic_write import atomic_write
from fbrl.registry import check_types


def save_config(config: TrainConfig, path: Path) -> None:
    """Writes the configuration as JSON; the file is replaced in one piece."""
    with atomic_write(path) as file:
        file.write((json.dumps(config_to_dict(config), indent=2) + "\n").encode())


def config_to_dict(config: TrainConfig) -> dict[str, Any]:
    """The configuration in the types that JSON knows, with all options of what fbrl has."""
    values = dataclasses.asdict(config)
    for kind, registry, name, options in config.components():
        values[f"{kind}_options"] = registry.with_defaults(name, options)
    values["run_dir"] = None if config.run_dir is None else str(config.run_dir)
    return _map(values, tuple, list)


def with_flat_options(config: TrainConfig) -> dict[str, Any]:
    """What :func:`config_to_dict` gives, with the options as entries such as ``reward.weight``."""
    values = config_to_dict(config)
    for kind in COMPONENTS:
        options = values.pop(f"{kind}_options")
        values |= {f"{kind}.{name}": value for name, value in options.items()}
    return values


def config_from_dict(values: Mapping[str, Any]) -> TrainConfig:
    """The configuration that :func:`config_to_dict` made a dictionary of.

    Raises:
        ConfigError: A field is unknown or of another type, or the scenario is missing.
    """
    try:
        values = _map(_without_former_options(values), list, tuple)
        ppo = PPOConfig(**values.get("ppo", {}))
        config = TrainConfig(**{**values, "ppo": ppo})
        run_dir = None if config.run_dir is None else Path(config.run_dir)
        options: dict[str, Any] = {
            f"{kind}_options": registry.without_defaults(name, options)
            for kind, registry, name, options in config.components()
        }
    except (TypeError, AttributeError) as error:
        raise ConfigError(f"This is no configuration of a training: {error}.") from error
    config = dataclasses.replace(config, run_dir=run_dir, **options)
    check_types(config)
    check_types(config.ppo)
    for _, registry, name, given in config.components():
        registry.check_options(name, given)
    return config


def _map(value: Any, kind: type, other: type) -> Any:
    """The same, with all lists as tuples, or the other way round."""
    if isinstance(value, Mapping):
        return {key: _map(entry, kind, other) for key, entry in value.items()}
    if isinstance(value, kind):
        return other(_map(entry, kind, other) for entry in value)  # type: ignore[attr-defined]
    return value


_OPTIONS_BEFORE = {
    "density": ("reward_options", None),
    "transition": ("reward_options", "possession"),
    "episode_cap": ("reward_options", None),
    "hidden_sizes": ("network_options", [256, 256]),
    "activation": ("network_options", "relu"),
}
"""Where an older fbrl's fields are now, and what they were by default."""


def _without_former_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """What an older fbrl wrote, in today's fields.

    What is left out only said how a training was run, or, ``preset``, where its values came from.
    """
    gone = ("compile", "cuda_graphs", "preset", *_OPTIONS_BEFORE)
    current = {name: value for name, value in values.items() if name not in gone}
    if current.get("collector") == "processes":
        current.update(collector="threads", num_workers=None)
    if "hidden_sizes" in values and current.get("observation") in PICTURES:
        current["network"] = None
    for name, (place, default) in _OPTIONS_BEFORE.items():
        is_used = place == "reward_options" or current.get("network", "mlp") is not None
        if name in values and values[name] != default and is_used:
            current[place] = {**current.get(place, {}), name: values[name]}
    return current
