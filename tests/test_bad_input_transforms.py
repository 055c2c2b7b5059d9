"""Wrong input to the transforms and the networks: one clear error each, and never a NaN reward."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from fbrl.models import MLP, ImpalaCNN, build_actor_critic
from fbrl.transforms import (
    AssistDensityReward,
    CheckpointReward,
    MiniMapCells,
    PlayStatistics,
    ScoringReward,
    Simple115,
    SuperMiniMap,
)
from fbrl.transforms.minimap import cells_to_planes

NAN = math.nan
REWARDS = {
    "possession": (AssistDensityReward, {}, "last_ball_carrier"),
    "consecutive": (AssistDensityReward, {"transition": "consecutive"}, "last_active"),
    "checkpoints": (CheckpointReward, {}, "checkpoints_collected"),
}


def observed(**changes):
    """The raw observation of two matches in which the controlled player has the ball."""
    integers = ("active", "ball_owned_team", "ball_owned_player", "game_mode")
    teams = ("left_team", "right_team")
    entries = {
        "ball": torch.zeros(2, 3),
        "ball_direction": torch.zeros(2, 3),
        **{key: torch.zeros(2, dtype=torch.int64) for key in integers},
        **{team: torch.zeros(2, 11, 2) for team in teams},
        **{f"{team}_direction": torch.zeros(2, 11, 2) for team in teams},
        **{f"{team}_roles": torch.zeros(2, 11, dtype=torch.int64) for team in teams},
    }
    return {**entries, **changes}


def transition(memory, **changes):
    following = {"reward": torch.zeros(2, 1), "done": torch.zeros(2, 1, dtype=torch.bool)}
    return TensorDict(
        {
            memory: torch.zeros(2, dtype=torch.int64),
            "next": TensorDict({**observed(), **following, **changes}, [2]),
        },
        [2],
    )


@pytest.mark.parametrize("kind", REWARDS)
@pytest.mark.parametrize(
    "ball", [[NAN, 0.0, 0.0], [0.9, NAN, 0.0], [NAN] * 3, [math.inf, 0.0, 0.0]]
)
def test_a_ball_that_is_nowhere_earns_nothing_and_never_makes_the_reward_nan(kind, ball):
    reward, options, memory = REWARDS[kind]
    step = transition(memory, ball=torch.tensor([ball, [0.9, 0.0, NAN]]))
    following = reward(**options)(step)["next"]
    assert following["reward"][0].item() == 0.0
    # z is not looked at.
    assert following["reward"][1].item() > 0.0
    for part in reward(**options).part_names:
        assert following[part].isfinite().all()


@pytest.mark.parametrize("kind", REWARDS)
def test_a_reward_says_what_it_cannot_relabel(kind):
    reward, options, _ = REWARDS[kind]
    for given, error, message in (
        (None, TypeError, "was given a NoneType; expected a TensorDict"),
        ({"next": 1}, TypeError, "was given a dict"),
        (TensorDict({"next": torch.zeros(2)}, [2]), KeyError, "no 'next' entry"),
    ):
        with pytest.raises(error, match=message):
            reward(**options)(given)


def test_a_memory_of_another_number_of_matches_is_refused():
    step = TensorDict({**transition("last_ball_carrier").exclude("last_ball_carrier")}, [])
    step["last_ball_carrier"] = torch.zeros(3, dtype=torch.int64)
    with pytest.raises(ValueError, match=r"'last_ball_carrier' has shape \(3,\); expected \(2,\)"):
        AssistDensityReward()(step)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"density": 5}, TypeError, "density is a int"),
        ({"weight": 10**400}, ValueError, "expected a finite number of at least 0"),
        ({"keys": "ball"}, TypeError, "keys is 'ball'; expected a dictionary"),
        ({"keys": {"ball": 5}}, TypeError, "keys renames 'ball' to 5; expected a text or a tuple"),
        ({"transition": ["possession"]}, ValueError, "transition is"),
    ],
)
def test_wrong_options_of_a_reward_are_named(options, error, message):
    with pytest.raises(error, match=message):
        AssistDensityReward(**options)


@pytest.mark.parametrize("transform", [MiniMapCells, SuperMiniMap])
def test_who_is_at_a_nan_position_is_not_on_the_mini_map(transform):
    left, ball = torch.zeros(2, 11, 2), torch.zeros(2, 3)
    left[0, 3, 1], ball[1, 0] = NAN, NAN
    match = TensorDict(observed(left_team=left, ball=ball, active=torch.tensor([3, 3])), [2])
    frame = transform()._reset(TensorDict({}, [2]), match)["minimap_cells"][:, -1]
    centre = 36 * 96 + 48
    assert frame[0, [2, 3, 22, 23]].tolist() == [centre, -1, centre, -1]
    assert frame[1, [2, 3, 22, 23]].tolist() == [centre, centre, -1, centre]


@pytest.mark.parametrize("active", [11, 99, -2])
def test_a_controlled_player_that_there_is_not_is_refused(active):
    match = TensorDict(observed(active=torch.tensor([0, active])), [2])
    with pytest.raises(ValueError, match=rf"active is \[0, {active}\]; it must be in \[-1, 10\]"):
        MiniMapCells()._reset(TensorDict({}, [2]), match)


@pytest.mark.parametrize("transform", [Simple115, MiniMapCells, SuperMiniMap, PlayStatistics])
def test_an_observation_that_is_missing_or_of_another_kind_is_named(transform):
    def read(match):
        return transform()._reset(TensorDict({}, [2]), match)

    for key in transform().in_keys:
        with pytest.raises(KeyError, match=f"{transform.__name__}: '{key}' is missing"):
            read(TensorDict(observed(), [2]).exclude(key))
        with pytest.raises(ValueError, match=f"'{key}' has shape"):
            read(TensorDict(observed(**{key: torch.zeros(2, 5)}), [2]))
        other = torch.float32 if observed()[key].dtype == torch.int64 else torch.int64
        with pytest.raises(TypeError, match=f"'{key}' has dtype {other}"):
            read(TensorDict(observed(**{key: observed()[key].to(other)}), [2]))
    with pytest.raises(TypeError, match=f"{transform.__name__} was given a dict"):
        read(observed())


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: MiniMapCells(1.5), TypeError, "num_frames is 1.5"),
        (lambda: MiniMapCells("4"), TypeError, "num_frames is '4'"),
        (lambda: MiniMapCells(True), TypeError, "num_frames is True"),
        (lambda: MiniMapCells(out_keys=[]), ValueError, "out_keys must name 1 keys"),
        (lambda: Simple115(in_keys=[]), ValueError, "in_keys must name 9 keys"),
        (lambda: ScoringReward(keys=["reward"]), TypeError, "expected a dictionary"),
    ],
)
def test_wrong_options_of_a_transform_are_named(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    "stack",
    [
        torch.zeros(2, 4, 23, dtype=torch.int16),
        torch.zeros(2, 3, 24, dtype=torch.int16),
        torch.zeros(2, 24, dtype=torch.int16),
        torch.zeros(2, 4, 24),
    ],
)
def test_frames_of_the_step_before_in_another_shape_are_refused(stack):
    before = TensorDict({"minimap_cells": stack}, [2])
    with pytest.raises(ValueError, match=r"torch.int16 of shape \(\*batch, 4, 24\)"):
        MiniMapCells()._step(before, TensorDict(observed(), [2]))


@pytest.mark.parametrize(
    ("before", "result", "error", "message"),
    [
        ({"play_memory": None}, {}, KeyError, "no 'play_memory'"),
        ({"play_statistics": torch.zeros(2, 5)}, {}, ValueError, r"expected \(..., 6\)"),
        (
            {},
            {"reward_scoring": None},
            KeyError,
            "no 'reward_scoring' in the step's result: put it",
        ),
    ],
)
def test_play_statistics_say_what_they_miss(before, result, error, message):
    def entries(values):
        return TensorDict({key: value for key, value in values.items() if value is not None}, [2])

    root = {"play_statistics": torch.zeros(2, 6), "play_memory": torch.zeros(2, 2).long(), **before}
    following = observed(reward_scoring=torch.zeros(2, 1)) | result
    with pytest.raises(error, match=message):
        PlayStatistics()._step(entries(root), entries(following))


@pytest.mark.parametrize("cells", [None, np.zeros((2, 4, 24), np.int16), torch.zeros(2, 4, 24)])
def test_cells_that_are_none_are_refused(cells):
    with pytest.raises(ValueError, match="cells are"):
        cells_to_planes(cells)


def test_a_cell_beyond_the_grid_is_refused_where_it_would_be_drawn_into_another_channel():
    cells = torch.full((1, 4, 24), 72 * 96, dtype=torch.int16)
    with pytest.raises(ValueError, match=r"A cell is 6912; cells must be in \[-1, 6911\]"):
        cells_to_planes(cells)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: build_actor_critic(["smm"]), TypeError, "observation is"),
        (lambda: build_actor_critic("smm", num_actions="19"), TypeError, "num_actions is '19'"),
        (lambda: ImpalaCNN((0, 24)), ValueError, r"observation_shape\[0\] is 0"),
        (lambda: ImpalaCNN((16, 96, 72)), ValueError, r"shape \(16, 96, 72\); .* 72, 96\)"),
        (lambda: MLP((0,)), ValueError, r"observation_shape\[0\] is 0"),
        (lambda: MLP((4, 24)), ValueError, r"shape \(4, 24\); the network mlp reads vectors"),
        (lambda: MLP(hidden_sizes="ab"), TypeError, "hidden_sizes is 'ab'"),
        (lambda: MLP(hidden_sizes=5), TypeError, "hidden_sizes is 5"),
        (lambda: MLP(hidden_sizes=(64, 1.5)), TypeError, r"hidden_sizes\[1\] is 1.5"),
        (lambda: MLP(hidden_sizes=(-1,)), ValueError, r"hidden_sizes\[0\] is -1"),
        (lambda: MLP(activation=["relu"]), ValueError, "activation is"),
        (lambda: ImpalaCNN(num_features=0), ValueError, "num_features is 0"),
    ],
)
def test_a_network_that_there_is_not_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    ("entries", "error", "message"),
    [
        ({}, KeyError, r"The policy reads 'simple115', which is not in the tensordict"),
        ({"simple115": torch.zeros(2, 114)}, ValueError, r"must be floating point of shape .*115"),
        ({"simple115": torch.zeros(2, 115).long()}, ValueError, "observation is torch.int64"),
    ],
)
def test_a_policy_says_what_it_cannot_read(entries, error, message):
    with pytest.raises(error, match=message):
        build_actor_critic("simple115").get_collection_policy()(TensorDict(entries, [2]))
