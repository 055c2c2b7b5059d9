"""The observation ``pixels`` shows what is on the pitch, where it is."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

import fbrl.cli.eval
import fbrl.cli.train
from fbrl.envs import OBSERVATION_SPACE, make_env
from fbrl.models import build_actor_critic
from fbrl.transforms import Pixels

BALL, CONTROLLED = (255, 255, 255), (255, 232, 56)
LEFT, RIGHT, LEFT_TRAIL = (48, 112, 240), (224, 48, 48), (32, 64, 128)


@pytest.fixture(scope="module")
def states() -> TensorDict:
    env = make_env("academy_counterattack_hard", num_envs=2, keep_keys=OBSERVATION_SPACE, seed=0)
    data = env.rollout(60, break_when_any_done=False).flatten(0, 1)[::7]
    env.close()
    return data


def pixel(position, height: int, width: int) -> tuple[int, int]:
    """Row and column of x and y in pitch units: 108.8 x 70.224 metres and four around them."""
    column = (float(position[0]) * 54.4 + 58.4) / 116.8 * width
    row = (float(position[1]) * 83.6 + 39.112) / 78.224 * height
    return min(max(int(row), 0), height - 1), min(max(int(column), 0), width - 1)


def shown(picture: torch.Tensor, colour: tuple[int, int, int]) -> np.ndarray:
    """Where a picture (3, height, width) has a colour, bool (height, width)."""
    return (picture == torch.tensor(colour).view(3, 1, 1)).all(0).numpy()


@pytest.mark.parametrize(("height", "width"), [(72, 96), (180, 270)])
def test_everybody_is_seen_where_he_is_in_the_colour_of_his_team(states, height, width):
    pictures = Pixels(height, width)(states.clone())["pixels"]
    assert pictures.shape == (len(states), 3, height, width)
    assert pictures.dtype == torch.uint8
    seen = 0
    for state, picture in zip(states, pictures, strict=True):
        ball = shown(picture, BALL)
        assert ball[pixel(state["ball"], height, width)]
        for team, colour in (("left_team", LEFT), ("right_team", RIGHT)):
            where = shown(picture, colour)
            for position, plays in zip(state[team], state[f"{team}_active"], strict=True):
                row, column = pixel(position, height, width)
                # Whoever is drawn later hides him.
                hidden = ball | shown(picture, LEFT) if team == "right_team" else ball
                assert plays
                assert where[row, column] or hidden[row, column]
                seen += where[row, column]
    assert seen > 0.9 * 22 * len(states)


def test_only_the_controlled_player_has_a_rim(states):
    state = states[:1].clone()
    state["ball"] = torch.tensor([[0.9, 0.4, 0.0]])
    for player in (3, 9):
        state["active"] = torch.tensor([player])
        (picture,) = Pixels(180, 270)(state.clone())["pixels"]
        rows, columns = shown(picture, CONTROLLED).nonzero()
        expected = pixel(state["left_team"][0, player], 180, 270)
        assert np.hypot(rows - expected[0], columns - expected[1]).max() < 6
    state["active"] = torch.tensor([-1])
    (picture,) = Pixels()(state)["pixels"]
    assert not shown(picture, CONTROLLED).any()


def test_a_trail_leads_to_where_a_player_was_a_second_ago(states):
    state = states[:1].clone()
    state["left_team_active"] = torch.zeros(1, 11, dtype=torch.int8)
    state["left_team_active"][0, 5] = 1
    state["right_team_active"].zero_()
    state["left_team"][0, 5] = torch.tensor([0.3, 0.1])
    state["left_team_direction"][0, 5] = torch.tensor([0.01, -0.01])
    state["ball"] = torch.tensor([[-0.9, 0.0, 0.0]])
    (picture,) = Pixels(144, 192)(state.clone())["pixels"]
    trail = shown(picture, LEFT_TRAIL)
    assert trail[pixel((0.2, 0.2), 144, 192)]
    assert trail[pixel((0.25, 0.15), 144, 192)]
    assert not trail[pixel((0.4, 0.0), 144, 192)]
    state["left_team_direction"].zero_()
    (picture,) = Pixels(144, 192)(state)["pixels"]
    assert not shown(picture, LEFT_TRAIL).any()
    assert shown(picture, LEFT).sum() == shown(picture, LEFT).any(0).sum() ** 2


def test_who_is_not_there_is_not_drawn_and_a_high_ball_is_larger(states):
    state = states[:1].clone()
    state["left_team_active"].zero_()
    state["right_team_active"].zero_()
    state["active"] = torch.tensor([-1])
    sizes = []
    for metres in (0.0, 10.0):
        state["ball"] = torch.tensor([[0.5, 0.0, metres]])
        (picture,) = Pixels(180, 270)(state.clone())["pixels"]
        assert not shown(picture, LEFT).any()
        assert not shown(picture, RIGHT).any()
        sizes.append(shown(picture, BALL).sum())
    assert sizes[1] > 2 * sizes[0]


@pytest.mark.parametrize("where", [(1.3, 0.0), (-1e9, 1e9), (float("nan"), 0.0)])
def test_a_ball_beside_the_picture_is_not_drawn(states, where):
    state = states[:1].clone()
    state["ball"] = torch.tensor([[*where, 0.0]])
    state["ball_direction"].zero_()
    (picture,) = Pixels()(state)["pixels"]
    assert not shown(picture, BALL).any()


def test_it_is_an_observation_of_environments_and_of_stored_steps():
    env = make_env(
        "academy_3_vs_1_with_keeper",
        num_envs=3,
        observation=Pixels(36, 48),
        keep_keys=OBSERVATION_SPACE,
        seed=0,
    )
    check_env_specs(env)
    data = env.rollout(6)
    env.close()
    drawn = Pixels(36, 48)(data.exclude("pixels", ("next", "pixels")))
    assert torch.equal(drawn["pixels"], data["pixels"])
    assert torch.equal(drawn["next", "pixels"], data["next", "pixels"])
    single = data[0, 0].exclude("pixels")
    assert torch.equal(Pixels(36, 48)(single)["pixels"], data["pixels"][0, 0])
    assert Pixels(36, 48)(data[:0])["pixels"].shape == (0, 6, 3, 36, 48)


@pytest.mark.parametrize(("height", "width"), [(36, 48), (72, 96), (100, 131)])
def test_the_networks_read_pictures_of_any_size(height, width):
    model = build_actor_critic(Pixels(height, width), is_mirrored=True)
    picture = torch.randint(0, 256, (2, 3, height, width), dtype=torch.uint8)
    batch = model.get_collection_policy()(TensorDict(pixels=picture, batch_size=[2]))
    assert batch["state_value"].shape == (2, 1)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ({"height": 8}, ValueError, r"height is 8; it must be in \[24, 1024\]"),
        ({"width": 5000}, ValueError, "width is 5000"),
        ({"width": 96.0}, TypeError, "width is 96.0"),
        ({"in_keys": ["ball"]}, ValueError, "in_keys must name 9 keys"),
    ],
)
def test_what_can_not_be_drawn_is_said(arguments, error, says):
    with pytest.raises(error, match=says):
        Pixels(**arguments)


def test_the_commands_train_and_evaluate_an_agent_that_looks_at_pictures(run_main, tmp_path):
    run_dir = tmp_path / "run"
    sizes = ["--observation.height", 36, "--observation.width", 48, "--num-envs", 2]
    length = ["--num-steps", 32, "--total-frames", 64, "--eval-episodes", 0]
    run_main(
        fbrl.cli.train.main,
        *("academy_empty_goal_close", "--observation", "pixels", "--mirror", "--run-dir", run_dir),
        *sizes,
        *length,
    )
    config = json.loads((run_dir / "config.json").read_text())
    assert config["observation_options"] == {"height": 36, "width": 48}
    assert "goal difference" in run_main(fbrl.cli.eval.main, run_dir, "--episodes", 2).out.lower()
