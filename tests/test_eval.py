"""``fbrl-eval`` and the loading of agents."""

from __future__ import annotations

import dataclasses
import json

import pytest
import torch

from fbrl.agent import load_agent, make_model
from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.config import config_to_dict, preset_config

SCENARIO = "academy_empty_goal_close"
SHOOT = 12


@pytest.fixture(scope="module")
def shooter(tmp_path_factory):
    """A run whose agent nearly always shoots, and always does in greedy mode."""
    config = dataclasses.replace(preset_config("light", SCENARIO), hidden_sizes=(8,), seed=4)
    model = make_model(config, torch.device("cpu"))
    with torch.no_grad():
        model.get_collection_policy().policy_head.bias[SHOOT] = 5.0
    run = tmp_path_factory.mktemp("run")
    path = run / "checkpoints" / "last.pt"
    save_checkpoint(path, config=config_to_dict(config), frames=123, model=model.state_dict())
    return run


def test_an_agent_is_loaded_with_its_weights(shooter):
    for path in (shooter, shooter / "checkpoints" / "last.pt"):
        agent = load_agent(path)
        assert (agent.config.scenario, agent.config.seed, agent.frames) == (SCENARIO, 4, 123)
        assert agent.model.get_collection_policy().policy_head.bias.argmax() == SHOOT


@pytest.mark.parametrize("change", ["no config", "no model", "other network", "other field"])
def test_a_checkpoint_that_fits_no_training_is_refused(shooter, tmp_path, change):
    content = dict(load_checkpoint(shooter))
    content.pop("format_version")
    if change == "no config":
        del content["config"]
    elif change == "no model":
        del content["model"]
    elif change == "other network":
        content["config"] = {**content["config"], "hidden_sizes": [16]}
    else:
        content["config"] = {**content["config"], "colour": "red"}
    save_checkpoint(tmp_path / "odd.pt", **content)
    with pytest.raises(CheckpointError, match=r"odd\.pt is not that of a training"):
        load_agent(tmp_path / "odd.pt")


def test_it_prints_and_writes_the_results_of_both_modes(shooter, run_program, tmp_path):
    line = ["fbrl-eval", shooter, "--episodes", 8, "--num-envs", 4, "--mode", "both"]
    done = run_program(*line, "--json", tmp_path / "out.json")
    assert (done.returncode, done.stderr) == (0, "")
    sampled, greedy = json.loads((tmp_path / "out.json").read_text())
    assert (sampled["mode"], greedy["mode"]) == ("sample", "greedy")
    assert greedy["scenario"] == SCENARIO
    assert (greedy["matches"], greedy["won"], greedy["lost"]) == (8, 8, 0)
    assert greedy["goal_difference"] == 1.0
    assert sampled["won"] + sampled["drawn"] + sampled["lost"] == sampled["matches"] == 8
    assert "+1.000" in done.stdout
    assert "8/0/0" in done.stdout
    assert "123 frames" in done.stdout
    again = run_program(*line, "--json", tmp_path / "again.json")
    assert again.returncode == 0
    assert (tmp_path / "again.json").read_text() == (tmp_path / "out.json").read_text()


def test_other_scenarios_can_be_played(shooter, run_program, tmp_path):
    scenarios = ["academy_empty_goal", "academy_run_to_score"]
    options = [part for name in scenarios for part in ("--scenario", name)]
    options += ["--episodes", 2, "--num-envs", 1, "--json", tmp_path / "out.json"]
    done = run_program("fbrl-eval", shooter, *options)
    assert done.returncode == 0, done.stderr
    assert [row["scenario"] for row in json.loads((tmp_path / "out.json").read_text())] == scenarios


BAD_INPUT = {
    "missing run": (["nowhere"], "no checkpoint at nowhere"),
    "no argument": ([], "RUN_OR_CHECKPOINT"),
    "scenario": (["nowhere", "--scenario", "academy_empty_gaol"], "academy_empty_goal"),
    "episodes": (["nowhere", "--episodes", "0"], "at least 1"),
    "seed": (["nowhere", "--seed", "-1"], "[0, 2**32 - 1]"),
    "mode": (["nowhere", "--mode", "best"], "greedy"),
    "unwritable": (["nowhere", "--json", "no/where.json"], "no directory"),
    "option": (["nowhere", "--colour"], "--colour"),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_answered_with_one_line_and_exit_code_2(case, run_program, tmp_path):
    arguments, expected = BAD_INPUT[case]
    done = run_program("fbrl-eval", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("fbrl-eval: error: ")
    assert done.stderr.count("\n") == 1
    assert expected in done.stderr
    assert list(tmp_path.iterdir()) == []
