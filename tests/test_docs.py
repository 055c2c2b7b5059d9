"""Pages say what the source says: scenarios, observations, actions, options; links lead on."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from conftest import REPOSITORY

from fbrl.cli import density, doctor, eval, plot, watch
from fbrl.config import CHANGEABLE_ON_RESUME, PPOConfig, TrainConfig
from fbrl.envs import OBSERVATION_SPACE, SCENARIOS
from fbrl.envs.actions import ACTION_NAMES
from fbrl.presets import PRESETS, preset_config
from fbrl.transforms.players_table import PLAYER_FEATURES, PLAYERS_FEATURES, SINGLE_FEATURES

DOCS = REPOSITORY / "docs"
PAGES = [
    path
    for pattern in ("*.md", "docs/*.md", "docs/api/*.md", "experiments/*/README.md")
    for path in sorted(REPOSITORY.glob(pattern))
]

PER_PAGE = pytest.mark.parametrize(
    "page", PAGES, ids=lambda path: str(path.relative_to(REPOSITORY))
)


def table(page: str, heading: str) -> list[list[str]]:
    """The rows of the first table under a heading of a page, without the code marks."""
    text = (DOCS / page).read_text().split(f"\n{heading}\n", 1)[1]
    lines = re.search(r"\n(\|.*?\n)\n", text, flags=re.DOTALL).group(1).splitlines()
    rows = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    return rows[2:]


def test_the_table_of_presets_has_every_value_in_which_they_differ():
    configs = [preset_config(preset, "academy_3_vs_1_with_keeper") for preset in PRESETS]
    values = [vars(config) | vars(config.ppo) for config in configs]
    differing = {
        f"--{name.replace('_', '-')}": [str(one[name]) for one in values]
        for name in values[0]
        if name != "ppo" and any(one[name] != values[0][name] for one in values)
    }
    assert {row[0]: row[1:] for row in table("learning.md", "## Presets")} == differing


def test_the_table_of_scenarios_is_that_of_the_source():
    ends = {
        "ends_on_score": "goal",
        "ends_on_out_of_play": "stop",
        "ends_on_possession_change": "turnover",
    }
    expected = [
        [
            scenario.name,
            f"{scenario.left_players} v {scenario.right_players}",
            str(scenario.duration),
            f"{scenario.right_difficulty:g}",
            ", ".join(word for field, word in ends.items() if getattr(scenario, field))
            or "time only",
            "alternates" if scenario.alternating_kick_off else "ours",
        ]
        for scenario in SCENARIOS.values()
    ]
    assert table("environment.md", "## Scenarios") == expected


def test_the_table_of_observations_is_that_of_the_space():
    rows = table("environment.md", "## Observations")
    assert {row[0] for row in rows} == set(OBSERVATION_SPACE)
    for name, shape, dtype, bounds, _ in rows:
        space = OBSERVATION_SPACE[name]
        low, high = space.low.min(), space.high.max()
        assert shape == str(space.shape), name
        assert dtype == str(space.dtype), name
        assert bounds == (f"{low:g} to {high:g}" if np.isfinite(low) else ""), name


def test_the_tables_of_the_numbers_of_players_are_those_of_the_source():
    once = table("players.md", "## Once")
    expected = [[str(column), *entry] for column, entry in enumerate(SINGLE_FEATURES.items())]
    assert once == expected
    names = list(PLAYERS_FEATURES)
    for mate, opponent, name, meaning in table("players.md", "## For each player"):
        assert PLAYER_FEATURES[name] == meaning
        assert names[int(mate)] == f"mate_1_{name}"
        assert opponent == "-" or names[int(opponent)] == f"opponent_1_{name}"
    listed = {name for _, _, name, _ in table("players.md", "## For each player")}
    assert listed == set(PLAYER_FEATURES)
    assert f"{len(names)} numbers" in (DOCS / "players.md").read_text()


def test_the_table_of_actions_is_that_of_the_source():
    cells = [cell for row in table("environment.md", "## Actions") for cell in row]
    pairs = zip(cells[::2], cells[1::2], strict=True)
    described = {int(index): text for index, text in pairs if index}
    assert len(described) == len(ACTION_NAMES)
    for index, name in enumerate(ACTION_NAMES):
        assert described[index].startswith(name.replace("_", " "))


def parser_options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The options of a command and of its subcommands."""
    for action in parser._actions:
        yield from action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            for subcommand in action.choices.values():
                yield from parser_options(subcommand)


def as_options(names: Iterable[str], prefix: str = "--") -> set[str]:
    return {prefix + name.replace("_", "-") for name in names}


def command_options() -> dict[str, set[str]]:
    """The options of each of fbrl's commands."""
    fields = [*dataclasses.fields(TrainConfig), *dataclasses.fields(PPOConfig)]
    switches = [field.name for field in fields if field.type == "bool"]
    train = as_options(field.name for field in fields) | as_options(switches, "--no-")
    train |= {"--import", "--preset"}
    commands = {
        f"fbrl-{module.__name__.rpartition('.')[2]}": set(parser_options(module._parser()))
        for module in (density, doctor, eval, plot, watch)
    }
    return {"fbrl-train": train | {"--resume", "--help"}, **commands}


@PER_PAGE
def test_commands_on_a_page_have_the_options_they_are_shown_with(page):
    options = command_options()
    lines = page.read_text().replace("\\\n", " ").splitlines()
    shown = [
        (command, option)
        for line in lines
        for command, arguments in re.findall(r"\b(fbrl-[a-z]+)\b([^`#&|;]*)", line)
        for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", arguments)
    ]
    assert [(command, option) for command, option in shown if option not in options[command]] == []


@PER_PAGE
def test_options_that_a_page_speaks_of_exist(page):
    scripts = [
        path.read_text()
        for pattern in ("experiments/*/*.py", "benchmarks/__main__.py")
        for path in REPOSITORY.glob(pattern)
    ]
    known = set().union(*command_options().values(), re.findall(r'"(--[a-z-]+)"', "".join(scripts)))
    spoken_of = re.findall(r"`(--[a-z]+(?:-[a-z]+)*)(?![-\w])", page.read_text())
    # Of TensorBoard's command, which keeps it on this machine.
    assert set(spoken_of) - known - {"--host", "--logdir"} == set()


def test_the_table_of_what_may_change_has_the_options_of_resume():
    cells = " ".join(row[0] for row in table("checkpoints.md", "## What may change"))
    assert set(re.findall(r"--[a-z-]+", cells)) == as_options(CHANGEABLE_ON_RESUME)


def test_the_scenario_of_ones_own_is_played(own_scenarios):
    text = (DOCS / "environment.md").read_text().split("### A scenario of your own")[1]
    code = re.search(r"```python\n(.*?)```", text, flags=re.DOTALL).group(1)
    environment = own_scenarios({"my_2_vs_1": code})
    program = """
from fbrl.presets import preset_config
from fbrl.envs import FootballEnv
preset_config("light", "my_2_vs_1").check()
env = FootballEnv("my_2_vs_1")
observation, _ = env.reset(seed=1)
env.step(5)
players = [int((observation[f"{side}_team_roles"] >= 0).sum()) for side in ("left", "right")]
print(players)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout == "[3, 2]\n", done.stderr


@PER_PAGE
def test_links_within_the_repository_lead_to_files(page):
    links = re.findall(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)", page.read_text())
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (page.resolve().parent / link).exists()] == []


def test_every_page_is_in_the_table_of_contents():
    index = (DOCS / "index.md").read_text()
    pages = {path.stem for path in DOCS.glob("*.md")} - {"index"}
    listed = set(re.findall(r"^(\w+)$", index, flags=re.MULTILINE))
    assert pages == listed


def test_the_readme_is_short():
    assert len((REPOSITORY / "README.md").read_text().splitlines()) < 150


def test_no_module_imports_one_of_a_later_layer():
    text = (REPOSITORY / "CONTRIBUTING.md").read_text().split("## Where things are")[1]
    layers = {
        path: number
        for number, line in enumerate(text.split("The same in one picture")[0].splitlines())
        for path in re.findall(r"`(fbrl/[\w/.]+)`", line)
    }

    def layer(path: str) -> int:
        return layers[max((known for known in layers if path.startswith(known)), key=len)]

    wrong = []
    for path in (REPOSITORY / "fbrl").rglob("*.py"):
        name = path.relative_to(REPOSITORY).as_posix()
        if name == "fbrl/__init__.py":
            continue
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("fbrl."):
                imported = node.module.replace(".", "/")
                folder = (REPOSITORY / imported).is_dir()
                if layer(imported + ("/" if folder else ".py")) > layer(name):
                    wrong.append((name, node.module))
    assert wrong == []
