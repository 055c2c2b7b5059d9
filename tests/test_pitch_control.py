"""The reading of Liu et al. in experiments/learning: influence, control, zones."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
import torch
from conftest import REPOSITORY
from scipy.stats import multivariate_normal
from tensordict import TensorDict

from fbrl.cli.train import main
from fbrl.envs import make_env

FOLDER = REPOSITORY / "experiments" / "learning"


@pytest.fixture
def pitch_control(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    yield importlib.import_module("pitch_control")
    sys.modules.pop("pitch_control", None)


def influence_of(player, velocity, ball, point):
    """Fernandez and Bornn (2018), equations 12 to 21, with matrices as they have them."""
    radius = min(10, 4 + np.hypot(*(player - ball)) ** 3 / 972)
    ratio = np.hypot(*velocity) ** 2 / 13**2
    scaling = np.diag([radius * (1 + ratio) / 2, radius * (1 - ratio) / 2])
    angle = np.arctan2(velocity[1], velocity[0])
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = rotation @ scaling @ scaling @ np.linalg.inv(rotation)
    density = multivariate_normal(player + velocity / 2, covariance)
    return density.pdf(point) / density.pdf(player)


def test_influence_is_that_of_the_paper(pitch_control):
    random = np.random.default_rng(0)
    players, ball = random.uniform(-40, 40, (5, 22, 2)), random.uniform(-40, 40, (5, 2))
    velocities = random.uniform(-6, 6, (5, 22, 2))
    points = random.uniform(-50, 50, (30, 2))
    distances = np.hypot(*np.moveaxis(players - ball[:, None], -1, 0))
    seen = pitch_control.influence(*map(torch.from_numpy, (players, velocities, distances, points)))
    expected = [
        [
            [influence_of(at, runs, ball[match], point) for point in points]
            for at, runs in zip(players[match], velocities[match], strict=True)
        ]
        for match in range(5)
    ]
    np.testing.assert_allclose(seen, expected, rtol=1e-8, atol=1e-12)


@pytest.fixture
def kick_off(pitch_control):
    """The state in which each team is in its own half."""
    env = make_env(
        "11_vs_11_stochastic",
        num_envs=1,
        observation=pitch_control.PitchControl(),
        keep_keys=pitch_control.PitchControl.fields,
        seed=0,
    )
    yield env.reset()
    env.close()


def test_a_team_controls_where_it_is(kick_off):
    picture = kick_off["pitch_control"]
    assert (picture.shape, picture.dtype) == ((1, 3, 24, 36), torch.uint8)
    along_the_pitch = picture[0, 0].float().mean(0)
    assert along_the_pitch[7:17].mean() > 145 > 110 > along_the_pitch[-17:-7].mean()


def test_the_controlled_player_and_the_ball_are_where_they_are(kick_off):
    player = kick_off["left_team"][0, kick_off["active"].item()]
    for plane, (x, y) in ((1, player.tolist()), (2, kick_off["ball"][0, :2].tolist())):
        row, column = divmod(kick_off["pitch_control"][0, plane].argmax().item(), 36)
        assert abs((row + 0.5) / 24 * 0.84 - 0.42 - y) < 0.04
        assert abs((column + 0.5) / 18 - 1 - x) < 0.06


def test_who_was_sent_off_controls_nothing(pitch_control, kick_off):
    for team in ("left_team", "right_team"):
        kick_off[f"{team}_active"] = torch.zeros_like(kick_off[f"{team}_active"])
    control, own, ball = pitch_control.PitchControl()(kick_off)["pitch_control"][0]
    assert control.unique().tolist() == [128]
    assert own.unique().tolist() == [0]
    assert ball.max() > 200


def test_zones_possession_and_dribbling_pay(pitch_control):
    # Our keeper has it, plays it to midfield, where the controlled 5 runs with it; then it is lost
    # in the last fifth.
    x = [-0.9, -0.5, 0.0, 0.1, 0.15, 0.12, 0.7, 0.9]
    team = [0, -1, 0, 0, 0, 0, 1, -1]
    player = [0, -1, 5, 5, 5, 5, 3, -1]
    active = [0, 5, 5, 5, 5, 5, 5, 5]
    states = TensorDict(
        ball=torch.tensor([[at, 0.1, 0.0] for at in x]),
        ball_owned_team=torch.tensor(team),
        ball_owned_player=torch.tensor(player),
        active=torch.tensor(active),
        batch_size=[8],
    )
    steps = states[:-1].set("next", states[1:].clone())
    steps["next"].update({"reward": torch.zeros(7, 1), "done": torch.zeros(7, 1, dtype=torch.bool)})
    reward = pitch_control.ZoneReward(zone=1.0, possession=10.0, dribbling=100.0)
    paid = reward(steps)["next"]
    assert paid["reward_zone"].flatten().tolist() == [-1, 0, 0, 0, 0, 2, 2]
    assert paid["reward_possession"].flatten().tolist() == [0, 10, 10, 10, 10, -10, 0]
    metres = [0, 0, 0.1 * 54.4, 0.05 * 54.4, -0.03 * 54.4, 0, 0]
    torch.testing.assert_close(
        paid["reward_dribbling"].flatten(), 10 * torch.tensor(metres), rtol=1e-5, atol=1e-5
    )


def test_it_is_trained_from_the_command_line(pitch_control, run_main, tmp_path):
    command = (
        "academy_3_vs_1_with_keeper --observation pitch_control:PitchControl "
        "--reward pitch_control:ZoneReward --network impala --observation.width 30 --num-envs 2 "
        "--num-steps 64 --num-minibatches 2 --total-frames 256 --eval-episodes 0 --device cpu"
    )
    printed = run_main(main, *command.split(), "--run-dir", tmp_path / "run")
    assert "Done after 256 frames" in printed.out
