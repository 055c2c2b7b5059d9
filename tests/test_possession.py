"""Where a trained agent has the ball."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from fbrl.assembly import make_model
from fbrl.checkpoint import CheckpointError, save_checkpoint
from fbrl.config_json import config_to_dict
from fbrl.evaluation.possession import BallPositions, ball_positions
from fbrl.figures.positions import read_positions, write_positions
from fbrl.presets import preset_config

SCENARIO = "academy_empty_goal_close"


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """An agent that has learned nothing yet."""
    config = dataclasses.replace(
        preset_config("light", SCENARIO), network_options={"hidden_sizes": (8,)}
    )
    torch.manual_seed(0)
    model = make_model(config, torch.device("cpu"))
    path = tmp_path_factory.mktemp("run") / "checkpoint.pt"
    save_checkpoint(path, config=config_to_dict(config), frames=0, model=model.state_dict())
    return path


def test_an_agent_starts_with_the_ball_in_front_of_the_empty_goal(checkpoint):
    done = []
    positions = ball_positions(checkpoint, 3, num_envs=2, on_progress=done.append)
    assert positions.shape[1] == 2
    assert len(positions) >= 4
    assert (np.abs(positions) <= [1.05, 0.45]).all()
    assert (positions[:2, 0] > 0.7).all()
    assert done == sorted(done)
    assert done[-1] == 4  # two places, two matches in each


def test_surplus_matches_are_left_out():
    positions = BallPositions()
    states = {
        "ball": torch.tensor([[0.5, 0.1, 0.0], [0.75, 0.2, 0.0], [0.25, 0.0, 0.0]]),
        "ball_owned_team": torch.tensor([0, 0, 0]),
        "ball_owned_player": torch.tensor([4, 4, 3]),
        "active": torch.tensor([4, 4, 4]),
    }
    for counted in ([True, False, True], [False, True, True]):
        positions(TensorDict(states, batch_size=[3]), torch.tensor(counted))
    np.testing.assert_allclose(positions.array(), [[0.5, 0.1], [0.75, 0.2]], rtol=1e-6)


def test_the_same_seed_gives_the_same_positions_and_leaves_torchs_seed_alone(checkpoint):
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    one, two = (ball_positions(checkpoint, 2, num_envs=2, seed=1) for _ in range(2))
    assert torch.rand(1) == expected
    np.testing.assert_array_equal(one, two)


def test_without_a_checkpoint_nothing_is_played(tmp_path):
    with pytest.raises(CheckpointError, match="no checkpoint"):
        ball_positions(tmp_path, 2)


def test_what_is_written_is_read(tmp_path):
    positions = np.array([[0.25, -0.125], [1.0, 0.42]])
    write_positions(tmp_path / "a.csv", positions)
    np.testing.assert_array_equal(read_positions(tmp_path / "a.csv"), positions)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no positions"),
        ("x,y\n", "holds no positions"),
        ("x,z\n1,2\n", "line 2: no position"),
        ("x,y\n1\n", "line 2 has 1 values, the header 2"),
        ("x,y\n1,here\n", "line 2: no position.*here"),
        ("x,y\n1,nan\n", "not finite"),
    ],
)
def test_what_is_no_table_of_positions_is_named(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"a\.csv.*{message}"):
        read_positions(path)
