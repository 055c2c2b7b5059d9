"""Masked actions lead to the state that idle leads to; what experts mask, case by case."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ActionMask, Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

import fbrl.transforms.action_masks
from fbrl.envs import ACTION_NAMES, OBSERVATION_SPACE, make_env
from fbrl.envs.engine import NUM_ACTIONS
from fbrl.envs.matches import Matches
from fbrl.transforms import EngineActionMask, ExpertActionMask

# Directions, kicks and the rest as often as idle, so that much is held.
_PLAYED = [0] * 4 + [1, 2, 3, 4, 5, 5, 5, 6, 7, 8] + list(range(9, 19))


def allowed(state: dict[str, np.ndarray]) -> torch.Tensor:
    held = torch.from_numpy(state["sticky_actions"])[None]
    return EngineActionMask()(TensorDict(sticky_actions=held, batch_size=[1]))["action_mask"][0]


def states_after(matches: Matches, state, actions) -> list[bytes | str]:
    """What each action leads to from a state; what was observed last where the match ended."""
    for match in range(len(actions)):
        matches.set_state(match, state)
    matches.step(range(len(actions)), actions)
    ended = set(matches.not_running())
    return [
        str({key: array[match].tolist() for key, array in matches.arrays.items()})
        if match in ended
        else matches.native.state(match)["engine"]
        for match in range(len(actions))
    ]


@pytest.mark.parametrize(
    "scenario", ["academy_3_vs_1_with_keeper", "academy_counterattack_hard", "5_vs_5"]
)
def test_an_action_that_the_engine_mask_leaves_out_leads_where_idle_leads(scenario):
    random = np.random.default_rng(0)
    matches = Matches(scenario, NUM_ACTIONS + 1, 2, OBSERVATION_SPACE)
    for match in range(NUM_ACTIONS + 1):
        matches.prepare(match, 7 + match, 2)
    matches.begin(range(NUM_ACTIONS + 1))
    masked, left = np.zeros(NUM_ACTIONS, int), np.zeros(NUM_ACTIONS, int)
    for seed in range(1000):
        state, observed = matches.get_state(NUM_ACTIONS), None
        if seed % 3 == 0:
            observed = {key: array[NUM_ACTIONS].copy() for key, array in matches.arrays.items()}
            mask = allowed(observed).numpy()
            actions = [0, *np.flatnonzero(~mask).tolist(), int(random.choice(np.flatnonzero(mask)))]
            idle, *others, other = states_after(matches, state, actions)
            assert [following == idle for following in others] == [True] * 3, actions
            masked[actions[1:-1]] += 1
            left[actions[-1]] += other != idle
        matches.step([NUM_ACTIONS], [int(random.choice(_PLAYED))])
        if NUM_ACTIONS in matches.not_running():
            matches.prepare(NUM_ACTIONS, seed, 2)
            matches.begin([NUM_ACTIONS])
    matches.close()
    # Every action that can be masked was, and most others do something.
    can_be_masked = [*range(1, 9), 13, 14, 15, 17, 18]
    assert (masked[can_be_masked] > 0).all()
    assert masked.sum() == 3 * 334
    assert left[1:].sum() > 200


def expert_allows(action: str, raw, from_x: float, half_width: float, idle: bool) -> bool:
    """The documented opinions, for one action of one state."""
    held = dict(zip([*ACTION_NAMES[1:9], "sprint", "dribble"], raw["sticky_actions"], strict=True))
    directions = ACTION_NAMES[1:9]
    x, y = raw["ball"][:2]
    distance = float(np.hypot(*(raw["ball"][:2] - raw["left_team"][raw["active"]])))
    owner = raw["ball_owned_team"]
    away = owner == 1 or (owner == -1 and distance > 0.03 and raw["game_mode"] == 0)
    in_zone = from_x <= x <= 1 and abs(y) <= half_width
    if action in held:
        return not held[action] and not (action == "dribble" and away)
    if action == "release_direction":
        return any(held[direction] for direction in directions)
    if action.startswith("release_"):
        return bool(held[action.removeprefix("release_")])
    if action in ("long_pass", "high_pass"):
        return not away and not in_zone
    if action == "short_pass":
        return not away
    if action == "shot":
        return not away and in_zone
    if action == "sliding":
        return away and not held["dribble"]
    return idle


def made_up_states(number: int) -> list[dict[str, np.ndarray]]:
    random = np.random.default_rng(0)
    states = []
    for _ in range(number):
        held = np.zeros(10, np.int8)
        held[random.integers(8)] = random.integers(2)
        held[8:] = random.integers(0, 2, 2)
        ball = random.uniform([-1, -0.42, 0], [1.05, 0.42, 1]).astype(np.float32)
        team = random.uniform(-1, 1, (11, 2)).astype(np.float32)
        active = random.integers(11)
        if random.random() < 0.5:
            team[active] = ball[:2] + random.uniform(-0.03, 0.03, 2)
        states.append(
            {
                "sticky_actions": held,
                "left_team": team,
                "ball": ball,
                "active": active,
                "ball_owned_team": random.integers(-1, 2),
                "game_mode": random.choice([0, 0, 0, 4]),
            }
        )
    return states


@pytest.mark.parametrize(
    ("options", "bounds"),
    [
        ({}, (0.64, 0.27, True)),
        ({"shot_from_x": 0.4, "shot_half_width": 0.3, "mask_idle": True}, (0.4, 0.3, False)),
    ],
)
def test_the_expert_mask_is_that_of_the_documented_opinions(options, bounds):
    states = made_up_states(400)
    entries = {key: np.stack([state[key] for state in states]) for key in states[0]}
    masks = ExpertActionMask(**options)(TensorDict(entries, batch_size=[400]))["action_mask"]
    for mask, raw in zip(masks.tolist(), states, strict=True):
        expected = [expert_allows(action, raw, *bounds) for action in ACTION_NAMES]
        assert mask == expected
    assert masks.any(0)[1:].all()
    assert (~masks).any(0)[1:].all()


@pytest.mark.parametrize("mask", [EngineActionMask, ExpertActionMask])
def test_random_actions_heed_the_mask_under_torchrls_transform(mask):
    env = make_env("academy_3_vs_1_with_keeper", num_envs=3, keep_keys=OBSERVATION_SPACE, seed=0)
    env = TransformedEnv(env.base_env, Compose(mask(), ActionMask()))
    check_env_specs(env)
    torch.manual_seed(0)
    data = env.rollout(100, break_when_any_done=False)
    assert data["action_mask"].gather(-1, data["action"].unsqueeze(-1)).all()
    recomputed = mask()(data.exclude("action_mask", ("next", "action_mask")))
    assert torch.equal(recomputed["action_mask"], data["action_mask"])
    assert torch.equal(recomputed["next", "action_mask"], data["next", "action_mask"])
    env.close()


def test_wrong_input_is_named_with_its_remedy():
    with pytest.raises(ValueError, match="ExpertActionMask: in_keys must name 6 keys"):
        ExpertActionMask(in_keys=["sticky_actions"])
    with pytest.raises(KeyError, match=r"EngineActionMask: 'sticky_actions' is missing"):
        EngineActionMask()(TensorDict(batch_size=[1]))


def test_documented_examples_run():
    outcome = doctest.testmod(fbrl.transforms.action_masks)
    assert outcome.attempted > 0
    assert outcome.failed == 0
