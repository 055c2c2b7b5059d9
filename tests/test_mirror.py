"""Mirrored matches: the same decisions, mirrored, whatever the observation."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from fbrl.envs import ACTION_NAMES, OBSERVATION_SPACE, make_env
from fbrl.models import build_actor_critic
from fbrl.models.mirror import MIRRORED_ACTIONS
from fbrl.transforms import (
    EngineActionMask,
    ExpertActionMask,
    MiniMapCells,
    Pixels,
    Players,
    Simple115,
    SuperMiniMap,
)

TRANSFORMS = {
    "minimap": MiniMapCells,
    "smm": SuperMiniMap,
    "simple115": Simple115,
    "players": Players,
    "pixels": Pixels,
}
ORDER = list(MIRRORED_ACTIONS)


@pytest.fixture(scope="module")
def matches() -> TensorDict:
    """Raw states of real matches, with the ball in either half, none exactly in the middle."""
    torch.manual_seed(0)
    kept = []
    for scenario in ("academy_counterattack_hard", "academy_3_vs_1_with_keeper", "5_vs_5"):
        env = make_env(
            scenario,
            num_envs=3,
            observation="players",
            keep_keys=OBSERVATION_SPACE,
            seed=0,
        )
        data = env.rollout(60, break_when_any_done=False)
        env.close()
        kept.append(data.select(*OBSERVATION_SPACE, "action_memory").flatten(0, 1))
    states = torch.cat(kept)
    return states[states["ball"][:, 1] != 0]


def mirrored(states: TensorDict) -> TensorDict:
    """The same matches seen in a mirror along the pitch."""
    flipped = states.clone()
    for key in ("ball", "ball_direction"):
        flipped[key][:, 1] *= -1
    for team in ("left_team", "right_team"):
        is_there = states[f"{team}_roles"] >= 0
        for key in (team, f"{team}_direction"):
            y = flipped[key][..., 1]
            flipped[key][..., 1] = torch.where(is_there, -y, y)
    # Held are left, top left, top, top right, right, bottom right, bottom, bottom left.
    flipped["sticky_actions"] = states["sticky_actions"][:, [0, 7, 6, 5, 4, 3, 2, 1, 8, 9]]
    last = states["action_memory"][:, 0]
    flipped["action_memory"][:, 0] = torch.where(last < 0, last, torch.tensor(ORDER)[last])
    return flipped


def off_borders(states: TensorDict) -> TensorDict:
    """Some of those in which nobody is just between two rows of the mini map, as at kick-offs."""
    y = torch.cat([states["left_team"][..., 1], states["right_team"][..., 1]], -1)
    chosen = states[(y != 0).all(-1)]
    assert len(chosen) > 60
    return chosen[:: len(chosen) // 60]


def observe(observation: str, states: TensorDict) -> TensorDict:
    trajectories = states.clone().unsqueeze(-1).refine_names(..., "time")
    return TRANSFORMS[observation]()(trajectories).squeeze(-1)


def test_the_mirror_image_of_an_action_is_that_of_its_direction():
    pairs = {"top": "bottom", "top_left": "bottom_left", "top_right": "bottom_right"}
    pairs |= {bottom: top for top, bottom in pairs.items()}
    assert [ACTION_NAMES[i] for i in ORDER] == [pairs.get(name, name) for name in ACTION_NAMES]


@pytest.mark.parametrize(
    ("observation", "mask"),
    [
        *((observation, None) for observation in TRANSFORMS),
        ("players", EngineActionMask),
        ("players", ExpertActionMask),
    ],
)
def test_a_mirrored_match_is_decided_as_the_match_is(matches, observation, mask):
    torch.manual_seed(0)
    model = build_actor_critic(observation, is_mirrored=True, is_masked=mask is not None)
    with torch.no_grad():
        model.get_collection_policy().policy_head.weight.mul_(100)
    states = matches if observation in ("players", "simple115") else off_borders(matches)
    results = []
    for raw in (states, mirrored(states)):
        seen = observe(observation, raw)
        if mask:
            seen = mask()(seen)
        with torch.no_grad():
            probabilities = model.get_policy_operator().get_dist(seen).probs
            results.append((probabilities, model.get_value_operator()(seen)["state_value"]))
    (one, value), (other, mirrored_value) = results
    torch.testing.assert_close(other, one[:, ORDER], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(mirrored_value, value, rtol=1e-4, atol=1e-5)
    # Neither would hold by itself.
    assert (one - one[:, ORDER]).abs().amax(-1).median() > 0.001


@pytest.mark.parametrize("observation", TRANSFORMS)
def test_what_is_seen_is_one_of_both_and_has_the_ball_in_the_lower_half(matches, observation):
    mirror = build_actor_critic(observation, is_mirrored=True).get_collection_policy().trunk.mirror
    states = matches if observation in ("players", "simple115") else off_borders(matches)
    key = {"minimap": "minimap_cells"}.get(observation, observation)
    as_it_is, flipped = (observe(observation, raw)[key] for raw in (states, mirrored(states)))
    seen, is_mirrored = mirror(as_it_is)
    is_upper = states["ball"][:, 1] < 0
    assert torch.equal(is_mirrored, is_upper)
    assert 0.2 < is_upper.float().mean() < 0.8
    assert torch.equal(seen[~is_upper], as_it_is[~is_upper])
    assert torch.equal(seen[is_upper], flipped[is_upper])


def test_only_gfootballs_actions_can_be_mirrored():
    with pytest.raises(ValueError, match="num_actions is 8, but only gfootball's 19"):
        build_actor_critic("players", num_actions=8, is_mirrored=True)
