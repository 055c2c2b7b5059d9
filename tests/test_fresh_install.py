"""fbrl's wheel in an environment with the packages that it declares, without gfootball or others.

The packages themselves are not downloaded anew, which would take gigabytes: they are links to those
of the environment that the tests run in.
"""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from importlib.metadata import Distribution, distribution, entry_points
from pathlib import Path

import pytest
from packaging.requirements import Requirement

COMMANDS = sorted(
    command.name for command in entry_points(group="console_scripts") if command.dist.name == "fbrl"
)
NOT_DECLARED = ("gfootball", "fbrl_engine", "cv2", "gym", "mplsoccer", "pandas", "matplotlib")


def required_by(name: str, found: dict[str, Distribution] | None = None) -> dict[str, Distribution]:
    """A distribution's requirements, and theirs, without extras."""
    found = {} if found is None else found
    for line in distribution(name).requires or ():
        requirement = Requirement(line)
        wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if wanted and requirement.name not in found:
            found[requirement.name] = distribution(requirement.name)
            required_by(requirement.name, found)
    return found


def link(installed: Distribution, site_packages: Path) -> None:
    for name in {file.parts[0] for file in installed.files or ()} - {"..", "__pycache__"}:
        if not (site_packages / name).exists():
            (site_packages / name).symlink_to(Path(installed.locate_file(name)))


@pytest.fixture(scope="module")
def programs(wheel_file, tmp_path_factory):
    """The directory of the fresh environment's programs."""
    directory = tmp_path_factory.mktemp("fresh")
    venv.create(directory, symlinks=True)
    (site_packages,) = directory.glob("lib/python*/site-packages")
    for installed in required_by("fbrl").values():
        link(installed, site_packages)
    pip = [sys.executable, "-m", "pip", "--python", directory / "bin" / "python"]
    subprocess.run([*pip, "install", "--no-deps", "--quiet", wheel_file], check=True)
    return directory / "bin"


@pytest.fixture
def run(programs, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(program, *arguments):
        return subprocess.run(
            [programs / program, *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
        )

    return run


def test_packages_that_are_not_declared_are_not_there(run):
    asked = run(
        "python",
        "-c",
        "import importlib.util, sys\n"
        "print([name for name in sys.argv[1:] if importlib.util.find_spec(name)])",
        *NOT_DECLARED,
    )
    assert asked.stdout.strip() == "[]", asked.stderr


PASS_INTO_THE_BOX = """
import torch
import fbrl, fbrl.density, fbrl.models, fbrl.transforms
from tensordict import TensorDict

state = {"ball": torch.tensor([0.75, 0.0, 0.0]), "game_mode": torch.tensor(0)}
state |= {name: torch.tensor(9) for name in ("active", "ball_owned_player")}
state |= {"ball_owned_team": torch.tensor(0), "reward": torch.zeros(1)}
step = TensorDict({"last_ball_carrier": torch.tensor(7), "next": state})
print(f"{fbrl.transforms.AssistDensityReward()(step)['next', 'reward'].item():.4f}")
print(fbrl.__file__)
"""


def test_rewards_densities_and_networks_work_without_the_engine(run, programs):
    used = run("python", "-c", PASS_INTO_THE_BOX)
    assert used.returncode == 0, used.stderr
    paid, file = used.stdout.split()
    assert paid == "0.0551"
    assert Path(file).is_relative_to(programs.parent)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(run, command):
    explained = run(command, "--help")
    assert explained.returncode == 0, explained.stderr
    assert explained.stdout.lower().startswith("usage:")


def test_training_says_how_to_get_the_engine(run):
    tried = run("fbrl-train", "academy_empty_goal_close", "--total-frames", "64")
    assert tried.returncode == 2
    assert tried.stdout == ""
    (line,) = tried.stderr.strip().splitlines()
    assert "engine can't be imported" in line
    assert "make setup" in line
