"""PARIS's features and reward, as experiments/learning restates them, on real matches."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
import torch
from conftest import REPOSITORY
from tensordict.nn import TensorDictModule

from fbrl.cli.train import main
from fbrl.envs import ACTION_NAMES, OBSERVATION_SPACE, make_env

FOLDER = REPOSITORY / "experiments" / "learning"
RIGHT = ACTION_NAMES.index("right")


@pytest.fixture
def paris(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    yield importlib.import_module("paris")
    sys.modules.pop("paris", None)


@pytest.fixture
def played(paris):
    """Two hundred steps of two matches, most of them to the right."""
    env = make_env(
        "11_vs_11_stochastic",
        num_envs=2,
        reward=paris.ParisReward(),
        observation=paris.ParisFeatures(),
        keep_keys=list(OBSERVATION_SPACE),
        seed=3,
    )
    random = torch.Generator().manual_seed(0)

    def choose(step_count):
        action = torch.randint(len(ACTION_NAMES), (2,), generator=random)
        return torch.where(torch.rand(2, generator=random) < 0.6, RIGHT, action)

    policy = TensorDictModule(choose, in_keys=["step_count"], out_keys=["action"])
    yield env.rollout(200, policy, break_when_any_done=False)
    env.close()


def zone(x, y):
    if abs(x) > 1 or abs(y) >= 0.42:
        return 5
    if -0.2 <= x <= 0.2:
        return 2
    is_in_box = abs(x) > 0.64 and abs(y) < 0.27
    if x < 0:
        return 0 if is_in_box else 1
    return 3 if is_in_box else 4


def available(raw, distance):
    """Long, high and short pass, shot, sprint, three releases, sliding and dribble, in order."""
    free = raw["ball_owned_team"] == -1 and not (distance > 0.03 and raw["game_mode"] == 0)
    kicks = free or raw["ball_owned_team"] == 0
    x, y = raw["ball"][:2]
    in_zone = 0.64 <= x <= 1 and abs(y) <= 0.27
    held = raw["sticky_actions"]
    return [
        *(kicks and not in_zone, kicks and not in_zone, kicks, kicks and in_zone, True),
        *(held[:8].any(), held[8], not kicks and not held[9], kicks, held[9]),
    ]


def features(raw):
    """The 208 numbers of one match, each written down where it belongs."""
    me = raw["active"]
    place, direction = raw["left_team"][me], raw["left_team_direction"][me]
    ball = raw["ball"]
    relative = ball[:2] - place
    distance = np.hypot(*relative)
    role, where = np.zeros(10), np.zeros(6)
    role[raw["left_team_roles"][me]] = where[zone(*ball[:2])] = 1
    owner = raw["ball_owned_team"]
    held = raw["sticky_actions"]
    player = [
        *available(raw, distance),
        *(*place, *direction * 100, np.hypot(*direction) * 100, *role),
        *(distance > 0.03, raw["left_team_tired_factor"][me], held[9], held[8]),
    ]
    speed = raw["ball_direction"] * 20
    of_ball = [*ball, *where, *relative, *speed, np.hypot(*speed[:2]), distance]
    numbers = [*player, *of_ball, owner != -1, owner == 0]
    for team in ("left_team", "right_team"):
        rows = []
        for who in range(11):
            if (team, who) != ("left_team", me):
                at, moves = raw[team][who], raw[f"{team}_direction"][who]
                rows.append([*at * 2, *moves * 100, np.hypot(*moves) * 100])
                rows[-1] += [np.hypot(*(at - place)) * 2, raw[f"{team}_tired_factor"][who]]
        numbers += [*np.ravel(rows), *min(rows, key=lambda row: row[5])]
    return np.array(numbers, np.float32)


def raw_states(batch):
    """Each match's states, as arrays by their keys."""
    return [
        [{key: batch[key][match, step].numpy() for key in OBSERVATION_SPACE} for step in range(200)]
        for match in range(2)
    ]


def test_features_are_those_of_each_match_alone(played):
    for match, states in enumerate(raw_states(played)):
        for step, raw in enumerate(states):
            expected = features(raw)
            assert expected.shape == (208,)
            np.testing.assert_allclose(
                played["paris"][match, step], expected, rtol=1e-4, atol=1e-5, err_msg=str(step)
            )


def test_the_matches_have_what_the_features_tell_apart(played):
    seen = played["paris"].flatten(0, 1)
    assert (seen[:, 32:38].amax(0) == 1).sum() >= 4, "zones"
    # All but the shot, for which nobody came near enough.
    assert (seen[:, :10].amax(0) == 1).tolist() == [True] * 3 + [False] + [True] * 6


def test_every_step_pays_for_the_balls_zone(played):
    pays = {0: -0.006, 1: -0.003, 2: 0, 3: 0.006, 4: 0.003, 5: 0}
    x, y = played["next", "ball"][..., :2].unbind(-1)
    expected = [
        [pays[zone(*at)] for at in zip(*match, strict=True)]
        for match in zip(x.tolist(), y.tolist(), strict=True)
    ]
    paid = played["next", "reward_zone"].squeeze(-1)
    assert len(paid.unique()) >= 3
    torch.testing.assert_close(paid, torch.tensor(expected))
    assert torch.equal(played["next", "reward"].squeeze(-1) - paid, torch.zeros(2, 200))


@pytest.fixture
def stored(played):
    """The same as stored data that has no memory, with another score, cards and end."""
    data = played.select(*OBSERVATION_SPACE, "next").clone()
    following = data["next"].select(*OBSERVATION_SPACE, "reward", "done", "terminated")
    scores = torch.zeros(2, 201, 2, dtype=torch.int64)
    scores[0, 50:, 0] = scores[0, 60:, 1] = scores[0, 70:, 0] = scores[1, 80:, 1] = 1
    scores[0, 70:, 0] = 2
    cards = {
        f"{team}_team_yellow_card": torch.zeros(2, 201, 11, dtype=torch.int8)
        for team in ("left", "right")
    }
    cards["left_team_yellow_card"][0, 90:, 4] = 1
    cards["right_team_yellow_card"][1, 95:, 6:8] = 1
    left = torch.arange(200, -1, -1).expand(2, -1)
    for key, value in {"score": scores, "steps_left": left, **cards}.items():
        data[key], following[key] = value[:, :-1].contiguous(), value[:, 1:].contiguous()
    following["reward"] = scores.float().diff(dim=1)[..., :1] - scores.float().diff(dim=1)[..., 1:]
    return data.set("next", following)


def test_the_network_reads_the_features_in_any_batch(paris, played):
    torch.manual_seed(0)
    network = paris.ParisNetwork(num_features=16)
    features = played["paris"]
    seen = network(features)
    assert seen.shape == (2, 200, 16)
    torch.testing.assert_close(network(features[1, 7]), seen[1, 7])
    with pytest.raises(ValueError, match=r"\(115,\); ParisNetwork reads that of Paris"):
        paris.ParisNetwork((115,))


def test_goals_cards_and_a_win_at_the_end_are_paid(paris, stored):
    paid = paris.ParisReward()(stored)["next"]
    steps = {
        name: {
            tuple(at): paid[f"reward_{name}"][tuple(at)].item()
            for at in paid[f"reward_{name}"].squeeze(-1).nonzero().tolist()
        }
        for name in ("scoring", "goal", "card", "win")
    }
    assert steps["scoring"] == {(0, 49): 1, (0, 59): -1, (0, 69): 1, (1, 79): -1}
    assert steps["goal"] == {at: 4 * value for at, value in steps["scoring"].items()}
    assert steps["card"] == {(0, 89): -1, (1, 94): 2}
    assert steps["win"] == {(0, 199): 5}
    parts = sum(paid[f"reward_{name}"] for name in ("scoring", "goal", "card", "win", "zone"))
    torch.testing.assert_close(paid["reward"], parts)


def test_it_is_trained_from_the_command_line(paris, run_main, tmp_path):
    command = (
        "academy_3_vs_1_with_keeper --observation paris:ParisFeatures --reward paris:ParisReward "
        "--network paris:ParisNetwork --reward.zone 0.001 --network.num-features 32 --num-envs 2 "
        "--num-steps 64 --num-minibatches 2 --total-frames 256 --eval-episodes 0 --device cpu"
    )
    printed = run_main(main, *command.split(), "--run-dir", tmp_path / "run")
    assert "Done after 256 frames" in printed.out
