"""``fbrl-eval`` and the loading of agents."""

from __future__ import annotations

import csv
import dataclasses
import functools
import json
import re

import pytest
import torch

from fbrl.agent import load_agent
from fbrl.assembly import make_model
from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.cli.eval import main
from fbrl.config import ConfigError
from fbrl.config_json import config_to_dict, save_config
from fbrl.evaluation.comparison import trained
from fbrl.presets import preset_config

SCENARIO = "academy_empty_goal_close"
SHOOT = 12


@pytest.fixture
def run_eval(run_main, tmp_path, monkeypatch):
    """Runs the command in an empty directory, in this process, which has imported torch."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return functools.partial(run_main, main)


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
        content["config"] = {**content["config"], "network_options": {"hidden_sizes": [16]}}
    else:
        content["config"] = {**content["config"], "colour": "red"}
    save_checkpoint(tmp_path / "odd.pt", **content)
    with pytest.raises(CheckpointError, match=r"odd\.pt is not that of a training"):
        load_agent(tmp_path / "odd.pt")


def test_it_prints_and_writes_the_results_of_both_modes(shooter, run_program, run_eval, tmp_path):
    line = [shooter, "--episodes", 8, "--num-envs", 4, "--mode", "both"]
    done = run_program("fbrl-eval", *line, "--json", "out.json", "--csv", "out.csv")
    assert done.returncode == 0, done.stderr
    sampled, greedy = json.loads((tmp_path / "out.json").read_text())["results"]
    assert (sampled["mode"], greedy["mode"]) == ("sample", "greedy")
    assert greedy["scenario"] == greedy["trained_on"] == SCENARIO
    assert (greedy["matches"], greedy["won"], greedy["lost"]) == (8, 8, 0)
    assert greedy["goal_difference"] == greedy["goals_for"] == greedy["shots"] == 1.0
    assert greedy["goals_against"] == greedy["passes"] == 0.0
    assert greedy["episode_reward_scoring"] == 1.0
    assert greedy["episode_reward"] >= greedy["episode_reward_start_density"] + 1.0
    assert sampled["won"] + sampled["drawn"] + sampled["lost"] == sampled["matches"] == 8
    assert "+1.000" in done.stdout
    assert "8/0/0" in done.stdout
    assert "123 frames" in done.stdout
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["mode"] for row in rows] == ["sample", "greedy"]
    assert float(rows[0]["goal_difference"]) == sampled["goal_difference"]
    # The same matches, and so the same numbers, in another process.
    assert run_eval(*line, "--json", "again.json").out == done.stdout
    assert (tmp_path / "again.json").read_text() == (tmp_path / "out.json").read_text()


def test_other_scenarios_can_be_played_and_policies_without_a_network(shooter, run_eval, tmp_path):
    scenarios = ["academy_empty_goal", "academy_run_to_score"]
    options = [part for name in scenarios for part in ("--scenario", name)]
    options += ["--policy", "idle", "--policy", "builtin-ai", "--episodes", 2]
    run_eval(shooter, *options, "--json", "out.json")
    rows = json.loads((tmp_path / "out.json").read_text())["results"]
    assert [(row["policy"], row["scenario"]) for row in rows] == [
        (policy, name) for policy in (str(shooter), "idle", "builtin-ai") for name in scenarios
    ]
    assert {row["matches"] for row in rows} == {2}
    goals = {(row["policy"], row["scenario"]): row["goal_difference"] for row in rows}
    assert goals["idle", "academy_empty_goal"] == 0.0
    assert goals["builtin-ai", "academy_empty_goal"] > 0.0
    assert all(row["mode"] is row["seed"] is row["reward"] is None for row in rows[2:])


def make_run(path, seed, goals=(), **changes):
    """A run's directory with an untrained agent and, with goals, a log that has them."""
    config = dataclasses.replace(
        preset_config("light", SCENARIO),
        network_options={"hidden_sizes": (8,)},
        seed=seed,
        **changes,
    )
    torch.manual_seed(seed)
    model = make_model(config, torch.device("cpu"))
    checkpoint = path / "checkpoints" / "last.pt"
    save_checkpoint(checkpoint, config=config_to_dict(config), frames=9, model=model.state_dict())
    save_config(config, path / "config.json")
    if goals:
        lines = [f"{1000 * (i + 1)},{value}" for i, value in enumerate(goals)]
        (path / "metrics.csv").write_text(
            "frames,match/goal_difference\n" + "\n".join(lines) + "\n"
        )
    return path


def test_seeds_are_pooled_and_configurations_compared(run_eval, tmp_path):
    runs = [make_run(tmp_path / f"analytics{seed}", seed) for seed in (1, 2, 3)]
    runs += [make_run(tmp_path / f"scoring{seed}", seed, reward="scoring") for seed in (1, 2)]
    printed = run_eval(*runs, "--episodes", 2, "--json", "out.json").out
    report = json.loads((tmp_path / "out.json").read_text())
    scores = [row["goal_difference"] for row in report["results"]]
    first, second = report["seeds"]
    assert [(part["configuration"], part["seeds"]) for part in (first, second)] == [
        ("analytics", 3),
        ("scoring", 2),
    ]
    # Three and two numbers have no quarter that could be left out.
    assert first["interquartile_mean"] == pytest.approx(sum(scores[:3]) / 3)
    assert second["interquartile_mean"] == pytest.approx(sum(scores[3:]) / 2)
    assert first["interquartile_mean_low"] <= first["interquartile_mean"]
    pairs = [(a > b) + 0.5 * (a == b) for a in scores[:3] for b in scores[3:]]
    (improvement,) = report["improvements"]
    expected = sum(pairs) / 6
    assert improvement["probability"] == pytest.approx(max(expected, 1 - expected))
    assert "interquartile mean" in printed
    assert "Probability that a seed" in printed


def test_a_runs_log_says_when_it_converged_and_what_the_paper_would_report(run_eval, tmp_path):
    run = make_run(tmp_path / "run", 0, goals=(0.1, 0.6, 0.3, 0.52, 0.45, 0.7))
    line = [run, "--episodes", 2, "--json", "out.json"]
    run_eval(*line)
    (row,) = json.loads((tmp_path / "out.json").read_text())["training"]
    assert (row["frames"], row["frames_until_threshold"]) == (6000, 4000)
    assert row["paper_goal_difference"] == 0.7
    assert re.search(
        r"run +6,000 +6,000 ", run_eval(*line, "--tolerance", 0, "--threshold", 0.65).out
    )
    assert re.search(r"run +6,000 +never ", run_eval(*line, "--threshold", 0.9).out)


@pytest.mark.usefixtures("no_engine")
def test_a_log_without_goal_differences_is_noticed_before_the_first_match(run_eval, tmp_path):
    run = make_run(tmp_path / "run", 0, goals=(0.1, 0.6))
    table = run / "metrics.csv"
    table.write_text(table.read_text().replace("match/goal_difference", "match/length"))
    printed = run_eval(run, "--json", "out.json", code=2)
    assert re.fullmatch(r"fbrl-eval: error: .*no metric 'match/goal_difference'.*\n", printed.err)
    assert not (tmp_path / "out.json").exists()


def test_a_single_run_has_no_seeds_to_pool(run_eval, tmp_path):
    run_eval(make_run(tmp_path / "run", 1), "--episodes", 2, "--json", "out.json")
    assert json.loads((tmp_path / "out.json").read_text())["seeds"] == []


def test_configurations_that_differ_in_more_than_the_seed_are_named_in_the_table(
    run_eval, tmp_path
):
    runs = [
        make_run(tmp_path / "shipped", 0),
        make_run(tmp_path / "none", 1, reward_options={"density": "uniform"}),
    ]
    run_eval(*runs, "--episodes", 2, "--json", "out.json")
    report = json.loads((tmp_path / "out.json").read_text())
    assert [row["configuration"] for row in report["results"]] == [
        "analytics",
        "analytics, reward.density uniform",
    ]
    assert report["seeds"] == []


def test_an_agent_does_not_play_the_matches_that_its_training_began_with(run_eval, tmp_path):
    run = make_run(tmp_path / "run", 5)
    rows = {}
    for seed in (5, 6):
        line = [run, "--seed", seed, "--episodes", 2, "--json", "out.json"]
        line += ["--policy", "random", "--scenario", SCENARIO, "--scenario", "academy_empty_goal"]
        run_eval(*line)
        results = json.loads((tmp_path / "out.json").read_text())["results"]
        rows[seed] = [row["evaluation_seed"] for row in results]
    assert rows == {5: [5 + 2**31, 5, 5, 5], 6: [6, 6, 6, 6]}


@pytest.mark.usefixtures("no_engine")
def test_a_seed_that_comes_twice_is_refused_before_the_first_match(run_eval, tmp_path):
    runs = [make_run(tmp_path / name, 1) for name in ("one", "two")]
    printed = run_eval(*runs, "--json", "out.json", code=2)
    assert printed.out == ""
    assert "both seed 1" in printed.err
    assert not (tmp_path / "out.json").exists()


def test_several_checkpoints_of_one_training_give_a_table(shooter, run_eval, tmp_path):
    content = {**load_checkpoint(shooter), "frames": 99}
    content.pop("format_version")
    save_checkpoint(tmp_path / "early.pt", **content)
    run_eval(shooter, "early.pt", "--episodes", 2, "--json", "out.json")
    report = json.loads((tmp_path / "out.json").read_text())
    assert [row["frames"] for row in report["results"]] == [123, 99]
    assert report["seeds"] == []


def test_a_density_that_is_gone_is_noticed_before_the_first_match(tmp_path):
    run = make_run(tmp_path / "run", 1, reward_options={"density": str(tmp_path / "gone.npz")})
    with pytest.raises(ConfigError, match=r"No density file at .*gone\.npz"):
        trained(run, torch.device("cpu"))


def test_a_truncated_checkpoint_is_refused(shooter, run_program, tmp_path):
    whole = (shooter / "checkpoints" / "last.pt").read_bytes()
    (tmp_path / "cut.pt").write_bytes(whole[: len(whole) // 2])
    done = run_program("fbrl-eval", "cut.pt", "--csv", "out.csv")
    assert (done.returncode, done.stdout) == (2, "")
    assert "cut.pt is damaged" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()


BAD_INPUT = {
    "missing run": (["nowhere"], "no checkpoint at nowhere"),
    "no argument": ([], "Name a run"),
    "policy": (["--policy", "best"], "builtin-ai"),
    "policy without scenario": (["--policy", "random"], "add --scenario"),
    "threshold": (["nowhere", "--threshold", "nan"], "finite"),
    "group": (["nowhere", "--scenario", "all-acadmy"], "all-academy"),
    "scenario": (["nowhere", "--scenario", "academy_empty_gaol"], "academy_empty_goal"),
    "episodes": (["nowhere", "--episodes", "0"], "0 is not in [1, 1,000,000,000]"),
    "seed": (["nowhere", "--seed", "-1"], "[0, 2**32 - 1]"),
    "mode": (["nowhere", "--mode", "best"], "greedy"),
    "no directory": (["nowhere", "--json", "no/where.json"], "no directory"),
    "unwritable": (["nowhere", "--csv", "/proc/out.csv"], "/proc/out.csv can't be written"),
    "device": (["nowhere", "--json", "/dev/null"], "is a device"),
    "one file for two": (["nowhere", "--json", "out", "--csv", "./out"], "a file of its own"),
    "option": (["nowhere", "--colour"], "--colour"),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_answered_with_one_line_and_exit_code_2(case, run_eval, tmp_path):
    arguments, expected = BAD_INPUT[case]
    printed = run_eval(*arguments, code=2)
    assert printed.out == ""
    assert re.fullmatch(r"fbrl-eval: error: [^\n]+\n", printed.err)
    assert expected in printed.err
    assert list(tmp_path.iterdir()) == []
