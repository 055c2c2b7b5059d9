"""The options of ``fbrl-train``: the fields of the configuration, as ``--help`` describes them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro
from docstring_parser import parse_from_object

from fbrl.config import (
    ACTIVATION_NAMES,
    COLLECTOR_NAMES,
    LOGGER_NAMES,
    MASK_NAMES,
    NETWORK_NAMES,
    OBSERVATION_NAMES,
    PRESET_NAMES,
    REWARD_NAMES,
    TRANSITION_NAMES,
    PPOConfig,
    TrainConfig,
)

_VALUES = {
    "scenario": "SCENARIO",
    "preset": "|".join(PRESET_NAMES),
    "reward": "|".join(REWARD_NAMES),
    "density": "FILE|uniform|mirrored|shuffled",
    "transition": "|".join(TRANSITION_NAMES),
    "observation": "|".join(OBSERVATION_NAMES),
    "mask": "|".join(MASK_NAMES),
    "network": "|".join(NETWORK_NAMES),
    "activation": "|".join(ACTIVATION_NAMES),
    "device": "auto|cpu|cuda|cuda:INDEX",
    "collector": "|".join(COLLECTOR_NAMES),
    "logger": f"[{{{','.join(LOGGER_NAMES)}}} ...]",
}
_VALUES_BY_TYPE = {int: "INT", float: "FLOAT", Path: "DIRECTORY"}


def parse_options(
    program: str, description: str, arguments: Sequence[str], defaults: TrainConfig
) -> TrainConfig:
    """Reads a command line.

    Args:
        program: The command's name.
        description: What ``--help`` begins with.
        arguments: The words of the command line.
        defaults: What is not given; the scenario has to be.
    """
    ppo = _as(_described(PPOConfig), defaults.ppo)
    options = tyro.cli(
        _described(TrainConfig),
        args=list(arguments),
        prog=program,
        description=description,
        default=_as(_described(TrainConfig), defaults, scenario=tyro.MISSING, ppo=ppo),
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.PositionalRequiredArgs),
    )
    config: TrainConfig = _as(TrainConfig, options, ppo=_as(PPOConfig, options.ppo))
    return config


@functools.cache
def _described(kind: type) -> Any:
    """A dataclass with the same fields, which tyro describes as they are meant.

    From the docstrings below the fields it would keep the line breaks, and from their types take
    ``STR`` for a name, or ``{None}|INT`` for what may be left out.
    """
    hints = get_type_hints(kind)
    texts = {part.args[1]: part.description for part in parse_from_object(kind).meta}
    described = []
    for name, hint in hints.items():
        text = " ".join((texts[name] or "").split())
        about = tyro.conf.arg(help=text, metavar=_metavar(name, hint))
        inner = _described(hint) if hint is PPOConfig else hint
        described.append((name, Annotated[inner, about]))
    return dataclasses.make_dataclass(
        kind.__name__, described, namespace={"__doc__": kind.__doc__}, frozen=True
    )


def _metavar(name: str, hint: Any) -> str | None:
    if name in _VALUES or get_origin(hint) is tuple:
        return _VALUES.get(name)
    kinds = get_args(hint) or (hint,)
    return next((_VALUES_BY_TYPE[kind] for kind in kinds if kind in _VALUES_BY_TYPE), None)


def _as(kind: Any, config: Any, **changes: Any) -> Any:
    """The same values in a class with the same fields."""
    return kind(**{name: getattr(config, name) for name in kind.__dataclass_fields__} | changes)
