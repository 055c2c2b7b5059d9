"""A reward, an observation, a mask and a network of one's own, from the command line alone."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fbrl.cli.eval
import fbrl.cli.plot
import fbrl.cli.train
import fbrl.cli.watch
from fbrl.agent import load_agent
from fbrl.assembly import make_training_reward
from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.components import OBSERVATIONS
from fbrl.config import TrainConfig
from fbrl.registry import ConfigError, import_modules
from fbrl.run_files import CHECKPOINT_NAME

OWN = Path(__file__).parents[1] / "examples" / "own"
SCENARIO = "academy_3_vs_1_with_keeper"
TINY = (
    *("--num-envs", "2", "--num-steps", "64", "--num-minibatches", "2", "--total-frames", "256"),
    *("--eval-episodes", "4", "--eval-interval", "0", "--device", "cpu"),
)
NAMES = {
    "reward": "pressing:PressingReward",
    "observation": "nearest:NearestPlayers",
    "mask": "patience:NoLongShots",
    "network": "attention:Transformer",
}
OPTIONS = {
    "reward": {"bonus": 0.25},
    "observation": {"num_players": 9},
    "mask": {"from_x": 0.75},
    "network": {"width": 16, "num_layers": 1},
}
NAMED = [word for kind, name in NAMES.items() for word in (f"--{kind}", name)]
GIVEN = [
    *("--reward.bonus", "0.25", "--observation.num-players", "9"),
    *("--mask.from-x", "0.75", "--network.width", "16"),
]
MODULES = [name.partition(":")[0] for name in NAMES.values()]
IMPORTS = [word for module in MODULES for word in ("--import", module)]


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    """A folder with the four files, and nothing of fbrl's."""
    return Path(shutil.copytree(OWN, tmp_path_factory.mktemp("own") / "files"))


@pytest.fixture(scope="module")
def trained(workplace):
    """The directory of a training with all four, by the command itself."""
    program = Path(sys.executable).with_name("fbrl-train")
    command = [program, SCENARIO, *TINY, *NAMED, *GIVEN, "--run-dir", "run"]
    done = subprocess.run(command, cwd=workplace, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return workplace / "run"


@pytest.fixture
def run(workplace, run_main, monkeypatch):
    """Runs commands where the files are, in this process, of which each has imported nothing."""

    def run(program, *arguments, code=0):
        forget_modules()
        return run_main(getattr(fbrl.cli, program).main, *arguments, code=code)

    monkeypatch.chdir(workplace)
    yield run
    forget_modules()


def forget_modules():
    for module in (*MODULES, "broken"):
        sys.modules.pop(module, None)


def test_they_are_trained_with_their_options(trained):
    config = json.loads((trained / "config.json").read_text())
    assert {kind: config[kind] for kind in NAMES} == NAMES
    assert {kind: config[f"{kind}_options"] for kind in NAMES} == OPTIONS
    with (trained / "metrics.csv").open() as file:
        assert "reward/pressing" in next(csv.reader(file))


def test_their_run_goes_on_is_evaluated_watched_and_plotted(trained, run, workplace):
    resumed = run("train", "--resume", trained, "--total-frames", 384, *IMPORTS)
    assert "Done after 384 frames" in resumed.out
    evaluated = run("eval", trained, "--episodes", 4, *IMPORTS)
    assert "goal difference" in evaluated.out
    run("watch", trained, "--out", "match.gif", "--width", 320, *IMPORTS)
    assert (workplace / "match.gif").stat().st_size > 1000
    run("plot", "curves", trained, "--out", "curves.png")


@pytest.mark.parametrize("command", [("train", "--resume"), ("eval",), ("watch",)], ids=" ".join)
def test_what_only_a_file_names_is_not_imported(trained, run, command):
    printed = run(*command, trained, *IMPORTS[2:], code=2)
    assert "--import pressing" in printed.err
    assert printed.err.count("\n") == 1
    assert "pressing" not in sys.modules


def test_help_shows_their_options(run):
    text = run("train", SCENARIO, *NAMED, "--help").out
    for expected in (*GIVEN[::2], "in goals", "of each team", "How far forward", "of a token"):
        assert expected in text


BAD = {
    "no such module": ("nowhere:Reward", "The module nowhere can't be imported"),
    "no such class": ("pressing:Presing", "pressing has no class Presing"),
    "no reward": ("nearest:NearestPlayers", "it must be a ScoringReward"),
    "a module that fails": ("broken:Reward", "broken can't be imported: ZeroDivisionError"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_can_not_be_used_is_named_in_one_line(case, run, workplace):
    (workplace / "broken.py").write_text("1 / 0\n")
    name, expected = BAD[case]
    printed = run("train", SCENARIO, "--reward", name, code=2)
    assert expected in printed.err
    assert printed.err.count("\n") == 1


def test_a_checkpoint_can_call_nothing_that_it_names(trained, tmp_path):
    """Not even what is imported anyway, such as ``os:system``."""
    content = load_checkpoint(trained)
    del content["format_version"]
    content["config"] |= {
        "observation": "os:system",
        "observation_options": {"command": f"touch {tmp_path / 'called'}"},
    }
    save_checkpoint(tmp_path / CHECKPOINT_NAME, **content)
    with pytest.raises(CheckpointError, match="nothing is imported that only a file names"):
        load_agent(tmp_path)
    assert not (tmp_path / "called").exists()


def test_it_is_named_in_python_alike(workplace, monkeypatch):
    monkeypatch.chdir(workplace)
    config = TrainConfig(SCENARIO, reward="pressing:PressingReward", reward_options={"bonus": 2.0})
    with pytest.raises(ConfigError, match=r"import_modules\(\['pressing'\]\)"):
        make_training_reward(config)
    import_modules(["pressing"])
    config.check()
    assert make_training_reward(config).bonus == 2.0
    with pytest.raises(ConfigError, match="has no option 'bonsu': it has bonus"):
        TrainConfig(SCENARIO, reward=config.reward, reward_options={"bonsu": 1.0}).check()


def test_an_installed_package_adds_names(tmp_path, monkeypatch):
    shutil.copy(OWN / "nearest.py", tmp_path / "installed_nearest.py")
    information = tmp_path / "nearest-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: nearest\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(
        "[fbrl.observations]\nnearest = installed_nearest:NearestPlayers\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert OBSERVATIONS.names[-1] == "nearest"
    assert OBSERVATIONS.make("nearest", {"num_players": 3}).num_players == 3
    TrainConfig(SCENARIO, observation="nearest").check()
