"""What users write into a scenario's file is checked before the engine sees it."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import types
from pathlib import Path

import pytest
from conftest import needs_engine

from fbrl.envs import ScenarioError
from fbrl.envs.engine import build_scenario, load_gfootball

NAME = "one_of_my_own"

PLAYABLE = """
from . import *


def build_scenario(builder):
    config = builder.config()
    config.game_duration = 400
    config.right_team_difficulty = 0.6
    builder.SetBallPosition(0.02, 0.0)
    builder.SetTeam(Team.e_Left)
    builder.AddPlayer(-1.0, 0.0, e_PlayerRole_GK)
    builder.AddPlayer(0.0, 0.0, e_PlayerRole_CM)
    builder.SetTeam(Team.e_Right)
    builder.AddPlayer(-1.0, 0.0, e_PlayerRole_GK)
    builder.AddPlayer(-0.5, 0.0, e_PlayerRole_CB)
"""

LEFT_KEEPER = "    builder.AddPlayer(-1.0, 0.0, e_PlayerRole_GK)\n"
MIDFIELDER = "    builder.AddPlayer(0.0, 0.0, e_PlayerRole_CM)\n"
RIGHT = PLAYABLE[PLAYABLE.index("    builder.SetTeam(Team.e_Right)") :]

UNPLAYABLE = {
    "keeper second": (LEFT_KEEPER + MIDFIELDER, MIDFIELDER + LEFT_KEEPER, "left .* role CM"),
    "no keeper": (LEFT_KEEPER + MIDFIELDER, MIDFIELDER, "left team's first player has the role CM"),
    "no right keeper": (RIGHT, RIGHT.replace("_GK", "_LB"), "right .* role LB; .*e_PlayerRole_GK"),
    "twelve players": (MIDFIELDER, 11 * MIDFIELDER, r"the left team has 12 players; .* 1 to 11"),
    "thirty opponents": (RIGHT, RIGHT + 28 * MIDFIELDER, "the right team has 30 players"),
    "no time": ("= 400", "= 0", r"game_duration is 0; it must be 1 to 1,000,000,000 steps"),
    "no end of time": ("= 400", "= 2000000000", "game_duration is 2000000000"),
    "time before": ("= 400", "= -7", "game_duration is -7"),
    "too hard": ("= 0.6", "= 50", r"right_team_difficulty is 50; it must be in \[0, 1\]"),
    "no difficulty": ("= 0.6", "= float('nan')", "right_team_difficulty is nan"),
    "ball nowhere": ("0.02, 0.0)", "0.02, float('nan'))", r"the ball is at \(0.02, nan\)"),
    "player far away": ("(0.0, 0.0", "(-3e38, 0.0", "player 1 of the left team .* within 100"),
    "no such role": ("_CB", "_XX", "NameError: .*e_PlayerRole_XX"),
    "nothing to build": ("build_scenario", "make", "AttributeError: .*build_scenario"),
    "an error of its own": ("Team.e_Left", "1 / 0", "ZeroDivisionError: division by zero"),
    "a number too large": ("= 400", "= 2 ** 40", "TypeError: "),
}


@pytest.fixture
def build(monkeypatch):
    """Builds a scenario from its file's text."""

    def build(text):
        load_gfootball()
        module = types.ModuleType(f"gfootball.scenarios.{NAME}")
        module.__package__ = "gfootball.scenarios"
        exec(text, module.__dict__)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return build_scenario(NAME, 1, 2)

    return build


def test_what_can_be_played_is_built(build):
    assert build(PLAYABLE).game_duration == 400
    assert len(build("def build_scenario(builder): pass").left_team) == 1  # gfootball adds a keeper
    assert len(build(PLAYABLE.replace(MIDFIELDER, 10 * MIDFIELDER)).left_team) == 11
    build(PLAYABLE.replace("_CM", "_GK"))


@pytest.mark.parametrize("case", UNPLAYABLE)
def test_what_the_engine_can_not_play_is_refused_with_what_is_allowed(case, build):
    old, new, message = UNPLAYABLE[case]
    assert old in PLAYABLE
    with pytest.raises(ScenarioError, match=f"scenario '{NAME}' .*{message}") as refused:
        build(PLAYABLE.replace(old, new))
    assert "\n" not in str(refused.value)


def test_every_scenario_of_gfootball_is_built():
    load_gfootball()
    folder = Path(importlib.util.find_spec("gfootball.scenarios").origin).parent
    names = [
        ".".join(path.relative_to(folder).with_suffix("").parts) for path in folder.rglob("*.py")
    ]
    names = [name for name in names if not name.endswith("__init__")]
    assert len(names) > 18
    for name in names:
        build_scenario(name, 1, 2)


REFUSED = (
    ("eval", "no_keeper", "first player has the role CM"),
    ("watch", "no_keeper", "first player has the role CM"),
    ("eval", "not_python", "SyntaxError: '(' was never closed"),
    ("eval", "imports_nothing", "No module named 'what_is_not_there'"),
)

COMMANDS = """
import importlib, sys

for word in sys.argv[1:]:
    program, scenario = word.split(":")
    try:
        command = importlib.import_module(f"fbrl.cli.{program}")
        command.main(["--policy", "idle", "--scenario", scenario, "--episodes", "2"])
    except SystemExit as end:
        print(end.code)
"""


@needs_engine
def test_a_command_answers_such_a_file_with_one_line(own_scenarios, tmp_path):
    environment = own_scenarios(
        {
            "no_keeper": PLAYABLE.replace(LEFT_KEEPER, ""),
            "not_python": "def build_scenario(",
            "imports_nothing": "import what_is_not_there",
        }
    )
    words = [f"{program}:{scenario}" for program, scenario, _ in REFUSED]
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, *words],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (done.returncode, done.stdout) == (0, "2\n" * len(REFUSED))
    for (program, _, reason), line in zip(REFUSED, done.stderr.splitlines(), strict=True):
        assert line.startswith(f"fbrl-{program}: error: ")
        assert reason in line
