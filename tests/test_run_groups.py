"""Which runs are pooled, and what the groups are called."""

from __future__ import annotations

import dataclasses

import pytest
from written_runs import write_run

from fbrl.analysis.run_groups import NOT_TRAINED, RunGroupError, group_runs, single_runs
from fbrl.analysis.run_log import read_run_log
from fbrl.config import TrainConfig


@pytest.fixture
def run(tmp_path):
    numbers = iter(range(100))
    return lambda **settings: read_run_log(
        write_run(tmp_path / f"run{next(numbers)}", {"frames": [1]}, **settings)
    )


def labels(*runs, **options):
    return [group.label for group in group_runs(runs, **options)]


def test_runs_that_differ_in_the_seed_are_pooled_in_the_order_of_their_first(run):
    a0, b0, a1 = run(seed=0), run(seed=0, reward="scoring"), run(seed=1)
    groups = group_runs([a0, b0, a1])
    assert [group.runs for group in groups] == [(a0, a1), (b0,)]
    assert groups[0].config == a0.config


def test_how_a_run_was_played_saved_and_evaluated_does_not_part_it(run):
    same = [
        run(seed=0), run(seed=1, device="cpu"), run(seed=2, num_threads=1),
        run(seed=3, checkpoint_interval=5), run(seed=4, eval_episodes=7, eval_untrained=True),
        run(seed=5, collector="ray", num_workers=2), run(seed=6, num_groups=3),
        run(seed=7, hang_timeout=1), run(seed=8, logger=("wandb",)),
    ]  # fmt: skip
    assert [len(group.runs) for group in group_runs(same)] == [len(same)]


def test_every_setting_either_parts_runs_or_does_not():
    """A new field of the configuration has to be put on one of the sides."""
    names = {field.name for field in dataclasses.fields(TrainConfig)}
    parting = {
        "scenario", "reward", "reward_options", "observation", "observation_options", "mask",
        "mask_options", "network", "network_options", "mirror", "collect_ahead", "ppo",
        "initial_weights", "midway_starts",
    }  # fmt: skip
    assert names == parting | NOT_TRAINED
    assert not parting & NOT_TRAINED


@pytest.mark.parametrize(
    "change",
    [
        {"reward": "scoring"},
        {"reward_options": {"density": "uniform"}},
        {"reward_options": {"transition": "consecutive"}},
        {"observation": "minimap"},
        {"network_options": {"hidden_sizes": (64,)}},
        {"network_options": {"activation": "tanh"}},
        {"scenario": "academy_corner"},
        {"ppo": {"learning_rate": 0.5}},
        {"ppo": {"total_frames": 5}},
    ],
)
def test_what_is_learned_and_how_parts_runs(run, change):
    assert len(group_runs([run(seed=0), run(seed=1, **change)])) == 2


def test_a_label_has_what_differs(run):
    assert labels(run(), run(reward="scoring")) == ["analytics", "scoring"]
    assert labels(run(), run(reward_options={"density": "uniform"})) == [
        "analytics reward, preset light",
        "reward.density uniform",
    ]
    assert labels(run(ppo={"gamma": 0.9}), run(network_options={"hidden_sizes": (8, 4)})) == [
        "gamma 0.9",
        "gamma 0.993, network.hidden_sizes 8 4",
    ]


def test_what_options_are_anyway_is_in_no_label(run):
    uniform = {"reward_options": {"density": "uniform"}}
    runs = [run(), run(reward="potential"), run(**uniform), run(reward="potential", **uniform)]
    assert labels(*runs) == [
        "analytics",
        "potential",
        "analytics, reward.density uniform",
        "potential, reward.density uniform",
    ]


def test_presets_are_told_apart_by_their_names_and_what_departs_from_them(run):
    assert labels(run(), run(preset="thesis")) == ["preset light", "preset thesis"]
    assert labels(run(), run(preset="thesis", ppo={"num_epochs": 9})) == [
        "preset light, num_epochs 4",
        "preset thesis, num_epochs 9",
    ]


def test_a_single_configuration_is_named_by_reward_and_preset(run):
    assert labels(run(seed=0), run(seed=1)) == ["analytics reward, preset light"]
    assert labels(run(), always=("reward",)) == ["analytics"]


def test_what_only_differs_between_scenarios_is_in_no_label(run):
    long = {"scenario": "11_vs_11_easy_stochastic", "ppo": {"total_frames": 9}}
    runs = [run(), run(reward="scoring"), run(**long), run(**long, reward="scoring")]
    assert labels(*runs) == ["analytics", "scoring"] * 2


def test_a_seed_cannot_count_twice(run):
    with pytest.raises(RunGroupError, match=r"run0 and .*run1 have the same .* both seed 3"):
        group_runs([run(seed=3), run(seed=3, device="cpu")])


def test_checkpoints_of_one_training_are_told_apart_by_their_frames(run):
    runs = [run(seed=seed) for seed in (1, 2, 1)]
    groups = group_runs(runs, frames=[200, 200, 100])
    assert [(group.label, len(group.runs)) for group in groups] == [
        ("frames 200", 2),
        ("frames 100", 1),
    ]
    (group,) = group_runs(runs[:2], frames=[200, 200])
    assert group.label == "analytics reward, preset light"
    with pytest.raises(RunGroupError, match="both seed 1"):
        group_runs(runs, frames=[200, 200, 200])
    over = [run(ppo={"total_frames": 200}), run(ppo={"total_frames": 200, "gamma": 0.9})]
    finished = group_runs(over, frames=[201, 256])
    assert [group.label for group in finished] == ["gamma 0.993", "gamma 0.9"]


def test_each_run_for_itself_is_named_by_its_directory(run):
    assert [group.label for group in single_runs([run(seed=3), run(seed=3)])] == ["run0", "run1"]


def test_no_runs_are_no_groups():
    assert group_runs([]) == []


def test_each_seed_may_have_begun_with_a_training_of_its_own(run):
    runs = [run(seed=0, initial_weights="a"), run(seed=1, initial_weights="b"), run(seed=0)]
    groups = group_runs(runs)
    assert [group.runs for group in groups] == [tuple(runs[:2]), (runs[2],)]
    assert [group.label for group in groups] == [
        "initial_weights given",
        "analytics reward, preset light",
    ]
