"""The agents that fbrl brings along play as well as their cards say."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch
from conftest import REPOSITORY

import fbrl
import fbrl.cli.eval
import fbrl.cli.train
import fbrl.cli.watch
from fbrl.agent import load_agent, save_agent
from fbrl.checkpoint import load_checkpoint
from fbrl.cli.train_options import parse_training
from fbrl.config import ConfigError
from fbrl.config_json import config_from_dict
from fbrl.evaluation.comparison import configurations, play, pool_seeds, trained
from fbrl.pretrained import locate, pretrained_names, read_card
from fbrl.scenarios import SCENARIOS

EASY = "pretrained:academy_3_vs_1_with_keeper"


@pytest.mark.parametrize("name", pretrained_names())
def test_an_agent_plays_as_well_as_its_card_says(name):
    card = read_card(name)
    evaluation = play(
        trained(locate(f"pretrained:{name}"), torch.device("cpu")),
        card["scenario"],
        episodes=128,
        seed=7,
        num_envs=8,
        greedy=False,
        device=torch.device("cpu"),
        on_progress=lambda finished: None,
    )
    low, high = evaluation.interval
    assert low <= card["goal_difference"] <= high
    assert card["low"] < card["goal_difference"] < card["high"]


@pytest.mark.parametrize("name", pretrained_names())
def test_a_card_says_where_an_agent_comes_from_and_its_file_nothing_of_a_machine(name):
    card = read_card(name)
    assert card["scenario"] in SCENARIOS
    assert name in (card["scenario"], f"{card['scenario']}_{card['reward']}")
    assert card["episodes"] >= 1000
    trainings = [parse_training("fbrl-train", line.split()[1:]) for line in card["commands"]]
    densities = {"analytics", "potential"} & {training.reward for training in trainings}
    assert ("StatsBomb" in card["credit"]) == bool(densities)
    assert card["license"]
    assert all(command.startswith("fbrl-train academy_") for command in card["commands"])
    content = load_checkpoint(locate(f"pretrained:{name}"))
    assert set(content) == {"format_version", "config", "frames", "model"}
    assert content["config"]["reward"] == card["reward"]
    assert content["config"]["run_dir"] is None
    assert not [value for value in content["config"].values() if "/" in str(value)]
    last = trainings[-1]
    learned = config_from_dict(content["config"])
    its = (card["scenario"], learned.ppo, learned.reward)
    assert (last.scenario, last.ppo, last.reward) == its
    assert last.observation == learned.observation
    assert card["frames"] >= content["frames"]


def test_the_page_of_agents_has_what_their_cards_say():
    page = (REPOSITORY / "docs" / "pretrained.md").read_text()
    for name in pretrained_names():
        card = read_card(name)
        goals = f"{card['goal_difference']:.3f} [{card['low']:.3f}, {card['high']:.3f}]"
        assert f"| `{name}` | {card['frames']:,} | {card['reward']} | {goals} |\n" in page


def test_an_agent_is_named_in_the_place_of_a_run(run_main, tmp_path):
    printed = run_main(fbrl.cli.eval.main, EASY, "--episodes", 4).out
    assert EASY in printed
    out = tmp_path / "match.gif"
    run_main(fbrl.cli.watch.main, EASY, "--width", 320, "--out", out)
    assert out.stat().st_size > 1000


def test_a_training_goes_on_from_an_agent(run_main, tmp_path):
    config = fbrl.load_agent(EASY).config
    run_main(
        fbrl.cli.train.main,
        *("academy_empty_goal_close", "--observation", config.observation),
        *("--initial-weights", EASY, "--num-envs", 2, "--num-steps", 16, "--total-frames", 32),
        *("--num-minibatches", 1, "--learning-rate", 1e-12, "--eval-episodes", 0),
        *("--run-dir", tmp_path / "run"),
    )
    weights, first = load_agent(tmp_path / "run").model.state_dict(), load_agent(EASY).model
    for name, weight in first.state_dict().items():
        torch.testing.assert_close(weights[name], weight, rtol=0, atol=1e-6)


def test_an_agent_that_there_is_not_is_answered_with_those_that_there_are(run_main):
    error = run_main(fbrl.cli.eval.main, "pretrained:messi", code=2).err
    assert "messi" in error
    assert "academy_3_vs_1_with_keeper" in error
    forgotten = run_main(fbrl.cli.eval.main, "academy_3_vs_1_with_keeper", code=2).err
    assert EASY in forgotten


def test_an_agent_that_was_chosen_counts_as_no_seed_of_a_configuration(tmp_path):
    twin = save_twin(tmp_path / "twin", seed=0)
    policies = [trained(path, torch.device("cpu")) for path in (Path(EASY), twin)]
    labels = configurations(policies)
    assert labels[EASY] == EASY
    assert EASY not in labels[str(twin)]
    rows = [
        {"policy": one.name, "mode": "sample", "scenario": "academy_corner", "goal_difference": 1.0}
        for one in policies
    ]
    other = trained(save_twin(tmp_path / "other", seed=1), torch.device("cpu"))
    rows.append({**rows[1], "policy": other.name})
    (pooled,) = pool_seeds([*policies, other], rows)
    assert pooled.seeds == 2


def save_twin(run_dir: Path, seed: int) -> Path:
    """A run of the configuration of the agent that comes along."""
    agent = load_agent(EASY)
    config = dataclasses.replace(agent.config, seed=seed)
    save_agent(dataclasses.replace(agent, config=config), run_dir / "checkpoints" / "last.pt")
    return run_dir


def test_an_agent_with_densities_of_its_own_is_not_saved_without_them(tmp_path):
    agent = load_agent(EASY)
    config = dataclasses.replace(agent.config, reward_options={"density": "my.npz"})
    with pytest.raises(ConfigError, match=r"my\.npz.*directory of its run"):
        save_agent(dataclasses.replace(agent, config=config), tmp_path / "agent.pt")
    assert not (tmp_path / "agent.pt").exists()


def test_an_agent_of_ones_own_is_saved_alone(tmp_path):
    agent = load_agent(EASY)
    path = tmp_path / "agent.pt"
    save_agent(agent, str(path))
    again = load_agent(path)
    assert again.config == agent.config
    assert again.frames == agent.frames
    assert again.run_dir is None
    for name, weight in agent.model.state_dict().items():
        assert torch.equal(again.model.state_dict()[name], weight)
