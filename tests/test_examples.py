"""Every example runs as it is printed in the docs, and shows what it says it shows."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys

import pytest
from conftest import REPOSITORY

from fbrl.density import AssistDensity

EXAMPLES = REPOSITORY / "examples"
WITHOUT_ENGINE = ("reward_in_torchrl", "relabel_replay_buffer", "custom_density")


@pytest.fixture
def run_example(monkeypatch, capsys, tmp_path):
    """Runs an example in an empty directory and returns what it printed."""

    def run(name: str, *arguments: object) -> str:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.fixture(scope="module")
def without_engine(tmp_path_factory):
    """What those print that need no engine, and where: one process that can't import gfootball."""
    folder = tmp_path_factory.mktemp("examples")
    program = [
        "import runpy, sys",
        "sys.modules['gfootball'] = sys.modules['fbrl_engine'] = None",
    ]
    for name in WITHOUT_ENGINE:
        path = str(EXAMPLES / f"{name}.py")
        program += [f"print('== {name}')", f"runpy.run_path({path!r}, run_name='__main__')"]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(program)],
        cwd=folder, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    # TorchRL's log is no part of what an example prints.
    lines = [line for line in done.stdout.splitlines(keepends=True) if "[torchrl]" not in line]
    blocks = (block.split("\n", 1) for block in "".join(lines).split("== ")[1:])
    return dict(blocks), folder


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+", text)]


def words(text: str) -> list[str]:
    """Its lines with an N in the place of each number."""
    return re.sub(r"\d[\d,]*(\.\d+)?", "N", text).splitlines()


def shown_outputs() -> dict[str, str]:
    """What the page says that each example prints."""
    sections = (REPOSITORY / "docs" / "examples.md").read_text().split("\n## ")[1:]
    example = re.compile(r"literalinclude\} \.\./examples/(\w+)\.py.*```text\n(.*)```", re.DOTALL)
    return dict(example.search(section).groups() for section in sections)


def test_the_page_shows_every_example_and_what_it_prints():
    assert sorted(shown_outputs()) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", WITHOUT_ENGINE)
def test_examples_print_what_the_page_shows(without_engine, name):
    printed, _ = without_engine
    shown = shown_outputs()[name]
    assert words(printed[name]) == words(shown)
    assert numbers(printed[name]) == pytest.approx(numbers(shown), abs=0.001)


def test_the_reward_in_a_pipeline_of_ones_own(without_engine):
    printed, _ = without_engine
    start, end = numbers(printed["reward_in_torchrl"])
    # 25 steps with the ball, and passes that are received in front of the goal.
    assert 0.001 < start < 0.025
    assert 0.05 < end < 1


def test_a_replay_buffer_is_relabelled(without_engine):
    printed, _ = without_engine
    recorded, relabelled, _, potential = numbers(printed["relabel_replay_buffer"])[-4:]
    assert recorded == 0.01
    assert relabelled > recorded > potential


def test_densities_of_ones_own(without_engine):
    printed, folder = without_engine
    metadata = AssistDensity.load(folder / "crosses.npz").metadata
    assert (metadata.n, metadata.credit) == (300, "")
    wing, goal, midfield = numbers(printed["custom_density"])[-3:]
    assert goal > 0.05 > wing > midfield == 0


def test_a_reward_of_ones_own_next_to_fbrls(run_example):
    output = run_example("custom_reward")
    assert words(output) == words(shown_outputs()["custom_reward"])
    ours, own = output.split("ProgressReward")
    assert "reward_start_density" in ours
    assert numbers(own.split("reward_progress")[1])[0] > 0


def test_a_network_of_ones_own(run_example):
    output = run_example("custom_network", "--frames", 1024)
    assert [line.split(" frames")[0] for line in output.splitlines()] == ["512", "1024"]
    assert words(output) == words(shown_outputs()["custom_network"])[:2]


def test_torchrls_collectors(run_example):
    output = run_example("torchrl_collectors", "--frames", 1024)
    assert words(output) == words(shown_outputs()["torchrl_collectors"])[:2]


def test_plain_gymnasium(run_example):
    output = run_example("gymnasium_match", "--matches", 2)
    assert [line.split(",")[0] for line in output.splitlines()] == [
        "match 0: goals +1",
        "match 1: goals +1",
    ]
    assert words(output) == words(shown_outputs()["gymnasium_match"])[:2]


def test_stable_baselines3(run_example):
    pytest.importorskip("stable_baselines3")
    output = run_example("stable_baselines3_ppo", "--steps", 512, "--matches", 2)
    assert words(output) == words(shown_outputs()["stable_baselines3_ppo"])
