"""The options of ``fbrl-train``: the fields of the configuration, as ``--help`` describes them."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro
from docstring_parser import parse, parse_from_object

from fbrl.analysis.run_log import read_run_log
from fbrl.checks import check_name
from fbrl.cli.arguments import IMPORT_HELP, add_import
from fbrl.cli.errors import Parser, ending_on_bad_input, fail, parsing
from fbrl.components import COMPONENTS, LOGGERS
from fbrl.config import CHANGEABLE_ON_RESUME, PPOConfig, TrainConfig
from fbrl.presets import PRESETS, preset_config
from fbrl.registry import Registry, import_modules, module_of

DESCRIPTION = """Train a football agent with PPO on a scenario of Google Research Football.

The defaults shown are those of the preset light; add --preset strong or thesis for theirs. Every
option can be set on top of a preset. Examples:
  fbrl-train academy_3_vs_1_with_keeper
  fbrl-train academy_counterattack_hard --preset strong \
--initial-weights pretrained:academy_3_vs_1_with_keeper
  fbrl-train academy_counterattack_hard --preset thesis --device cuda
  fbrl-train 11_vs_11_easy_stochastic --reward scoring --total-frames 2000000 --num-envs 16

A reward, an observation, a mask or a network of your own is named by where it is; its arguments are
options, and --help shows them:
  fbrl-train academy_3_vs_1_with_keeper --reward my_rewards:Pressing --reward.distance 0.1

A training that was interrupted, or that died, goes on as if it had never stopped with
  fbrl-train --resume RUN_DIR

Of its options only a few can then be changed, see fbrl-train --resume RUN_DIR --help.

Where tcmalloc is installed, it takes the place of the C library's allocator, which makes matches
faster; FBRL_TCMALLOC=0 in the environment prevents that.
"""

RESUME_DESCRIPTION = """Go on with a training where it stopped, as if it had never stopped. Its
configuration is that of RUN_DIR, but for what is given here. The learning rate falls to 0 at
--total-frames: raising these raises it again."""

_VALUES = {"scenario": "SCENARIO", "device": "auto|cpu|cuda|cuda:INDEX"}
_VALUES_BY_TYPE = {int: "INT", float: "FLOAT", str: "TEXT", Path: "DIRECTORY"}


def parse_training(program: str, arguments: Sequence[str]) -> TrainConfig:
    """Reads the command line of a new training: a preset, and what is changed on top of it.

    Modules that it names are imported; whatever is wrong ends the process with one line.
    """
    with ending_on_bad_input(program):
        names = _names(program, arguments)
        check_name("preset", names.preset, PRESETS)
        given = {kind: name for kind in COMPONENTS if (name := getattr(names, kind)) is not None}
        import_modules(filter(None, map(module_of, given.values())))
        # The scenario decides between the rows of the thesis's table, so it is read first.
        scenario = _parse(program, arguments, names.preset, "", given).scenario
        config = _parse(program, arguments, names.preset, scenario, given)
        config.check()
        return config


def _parse(
    program: str, arguments: Sequence[str], preset: str, scenario: str, given: Mapping[str, Any]
) -> TrainConfig:
    """Parses with the defaults of a preset and the options of the components that are given."""
    config = dataclasses.replace(preset_config(preset, scenario), **given)
    components = list(config.components())
    about = f"Where the defaults come from. {_explained(PRESETS)}."
    options: list[Any] = [_annotated("preset", str, about, preset, "|".join(PRESETS))]
    options.append(_modules_field())
    texts = _texts(TrainConfig)
    for entry in dataclasses.fields(TrainConfig):
        kind = entry.name.removesuffix("_options")
        if entry.name == "ppo":
            inner = _dataclass(PPOConfig, _texts(PPOConfig), vars(config.ppo))
            options.append(_group("ppo", "", inner))
        elif entry.name == kind:
            default = tyro.MISSING if kind == "scenario" else getattr(config, kind)
            options.append(_train_field(kind, texts[kind], default))
        for this, registry, name, values in components:
            if entry.name == f"{this}_options":
                described = _options_of(registry, name, values)
                options.append(_group(entry.name, this, described))
    command = dataclasses.make_dataclass("TrainConfig", options, frozen=True)
    with parsing(program):
        parsed: Any = tyro.cli(
            command,
            args=list(arguments),
            prog=program,
            description=DESCRIPTION,
            config=(tyro.conf.PositionalRequiredArgs,),
        )
    fields = [f.name for f in dataclasses.fields(config)]
    values = {name: getattr(parsed, name) for name in fields if hasattr(parsed, name)}
    for kind, registry, name, _ in components:
        chosen = vars(values[f"{kind}_options"])
        values[f"{kind}_options"] = registry.without_defaults(name, chosen)
    return TrainConfig(**{**values, "ppo": PPOConfig(**vars(parsed.ppo))})


def parse_resume(program: str, arguments: Sequence[str]) -> TrainConfig:
    """Reads the command line of a training that goes on: what may be changed of its configuration.

    Modules that it names are imported; whatever is wrong ends the process with one line.
    """
    with ending_on_bad_input(program):
        names = _names(program, arguments)
        config = TrainConfig("") if names.help else read_run_log(names.resume).config
        changes = _parse_changes(program, arguments, names.resume, config)
        same_workers = changes["num_workers"] == config.num_workers
        if changes["collector"] != config.collector and same_workers:
            # How many workers there were belongs to where the matches were played.
            changes["num_workers"] = None
        ppo = dataclasses.replace(config.ppo, total_frames=changes.pop("total_frames"))
        config = dataclasses.replace(config, run_dir=names.resume, ppo=ppo, **changes)
        config.check()
        return config


def _parse_changes(
    program: str, arguments: Sequence[str], run_dir: Path, config: TrainConfig
) -> dict[str, Any]:
    """Parses with the values of a run as defaults."""
    texts = _texts(PPOConfig) | _texts(TrainConfig)
    fields = [_annotated("resume", Path, "The run's directory.", run_dir), _modules_field()]
    for name in CHANGEABLE_ON_RESUME:
        default = getattr(config if hasattr(config, name) else config.ppo, name)
        fields.append(_train_field(name, texts[name], default))
    with parsing(program):
        parsed: Any
        parsed, others = tyro.cli(
            dataclasses.make_dataclass("Resume", fields, frozen=True),
            args=list(arguments),
            prog=program,
            description=RESUME_DESCRIPTION,
            return_unknown_args=True,
        )
    if others:
        changeable = ", ".join("--" + name.replace("_", "-") for name in CHANGEABLE_ON_RESUME)
        fail(
            program,
            f"{others[0].split('=')[0]} can't be given with --resume, which takes everything from "
            f"the run but {changeable}.",
        )
    return {name: getattr(parsed, name) for name in CHANGEABLE_ON_RESUME}


def _names(program: str, arguments: Sequence[str]) -> argparse.Namespace:
    """What decides which options there are."""
    parser = Parser(prog=program, add_help=False)
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--resume", type=Path)
    parser.add_argument("--preset", default=next(iter(PRESETS)))
    add_import(parser)
    for kind in COMPONENTS:
        parser.add_argument(f"--{kind}")
    return parser.parse_known_args(list(arguments))[0]


_HINTS = get_type_hints(PPOConfig) | get_type_hints(TrainConfig)

Field = tuple[str, Any, Any]
"""Of a dataclass that tyro reads: its name, its annotated type, its default."""


def _train_field(name: str, text: str, default: Any) -> Field:
    metavar = _VALUES.get(name)
    if name == "logger":
        metavar = f"[{'|'.join(LOGGERS.names)} ...]"
    elif name in COMPONENTS:
        registry = COMPONENTS[name]
        values = {value: built_in.about for value, built_in in registry.built_in.items()}
        values |= {value: "installed" for value in registry.names if value not in values}
        text = f"{text} {_explained(values)}; or module:Class."
        metavar = "|".join([*values, "MODULE:CLASS"])
    return _annotated(name, _HINTS[name], text, default, metavar)


def _explained(values: Mapping[str, str]) -> str:
    return "; ".join(f"{value}: {about}" for value, about in values.items())


def _modules_field() -> Field:
    about = tyro.conf.arg(name="import", metavar="MODULE", help=IMPORT_HELP)
    hint = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, about]
    return "modules", hint, dataclasses.field(default=())


def _annotated(name: str, hint: Any, text: str, default: Any, metavar: str | None = None) -> Field:
    about = tyro.conf.arg(help=" ".join(text.split()), metavar=metavar or _metavar(hint))
    return name, Annotated[hint, about], dataclasses.field(default=default)


def _metavar(hint: Any) -> str | None:
    if get_origin(hint) is Literal:
        return "|".join(map(str, get_args(hint)))
    if get_origin(hint) is tuple:
        return None
    kinds = get_args(hint) or (hint,)
    return next((_VALUES_BY_TYPE[kind] for kind in kinds if kind in _VALUES_BY_TYPE), None)


def _group(name: str, prefix: str, described: Any) -> Field:
    about = tyro.conf.arg(name=prefix, prefix_name=bool(prefix))
    return name, Annotated[described, about], dataclasses.field(default_factory=described)


def _options_of(registry: Registry, name: str, values: Mapping[str, Any]) -> Any:
    options = registry.options(name)
    defaults = {
        f.name: tyro.MISSING if f.default is dataclasses.MISSING else f.default
        for f in dataclasses.fields(options)
    }
    described = _dataclass(options, _texts(options), defaults | dict(values))
    described.__doc__ = f"Of the {registry.kind} {name}."
    return described


def _dataclass(kind: Any, texts: Mapping[str, str], defaults: Mapping[str, Any]) -> Any:
    hints = get_type_hints(kind)
    described = [
        _annotated(
            f.name, hints[f.name], texts.get(f.name, ""), defaults[f.name], f.metadata.get("values")
        )
        for f in dataclasses.fields(kind)
    ]
    return dataclasses.make_dataclass(
        kind.__name__, described, namespace={"__doc__": kind.__doc__}, frozen=True
    )


def _texts(kind: Any) -> dict[str, str]:
    """What is said of a dataclass's fields below them, or of arguments in a docstring."""
    parts = parse(kind.__doc__ or "").meta
    for base in reversed(kind.__mro__[:-1]):  # without object
        parts += parse_from_object(base).meta
    return {part.args[1]: part.description or "" for part in parts if len(part.args) > 1}
