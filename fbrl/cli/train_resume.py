"""``fbrl-train --resume RUN_DIR``: the command line of a training that goes on."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import get_origin, get_type_hints

from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.checks.names import UnknownNameError
from fbrl.cli.errors import Parser, fail
from fbrl.config import CHANGEABLE_ON_RESUME, ConfigError, PPOConfig, TrainConfig

RESUME_DESCRIPTION = """Go on with a training where it stopped, as if it had never stopped. Its
configuration is that of RUN_DIR, but for what is given here. The learning rate falls to 0 at
--total-frames: raising these raises it again."""


def asks_to_resume(arguments: Sequence[str]) -> bool:
    """Whether ``--resume`` is among the arguments."""
    return any(argument.split("=")[0] == "--resume" for argument in arguments)


def parse_resume(program: str, arguments: Sequence[str]) -> TrainConfig:
    """The configuration of the run in a directory, with what may be changed on top of it."""
    parser = Parser(prog=program, description=RESUME_DESCRIPTION)
    parser.add_argument("--resume", type=Path, metavar="RUN_DIR", required=True)
    kinds = get_type_hints(PPOConfig) | get_type_hints(TrainConfig)
    for name in CHANGEABLE_ON_RESUME:
        if kinds[name] is bool:
            parser.add_argument(_option(name), action=argparse.BooleanOptionalAction)
        elif get_origin(kinds[name]) is tuple:
            parser.add_argument(_option(name), nargs="*")
        else:
            parser.add_argument(_option(name), type=str if kinds[name] is str else int)
    options, others = parser.parse_known_args(list(arguments))
    if others:
        fail(
            program,
            f"{others[0].split('=')[0]} can't be given with --resume, which takes everything from "
            f"the run but {', '.join(map(_option, CHANGEABLE_ON_RESUME))}.",
        )
    changes = {name: getattr(options, name) for name in CHANGEABLE_ON_RESUME}
    changes = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in changes.items()
        if value is not None
    }
    try:
        config = read_run_log(options.resume).config
        if changes.get("collector", config.collector) != config.collector:
            # How many workers there were belongs to where the matches were played.
            changes.setdefault("num_workers", None)
        ppo = config.ppo
        if "total_frames" in changes:
            ppo = dataclasses.replace(ppo, total_frames=changes.pop("total_frames"))
        config = dataclasses.replace(config, run_dir=options.resume, ppo=ppo, **changes)
        config.check()
    except (ConfigError, UnknownNameError, RunLogError) as error:
        fail(program, error)
    return config


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
