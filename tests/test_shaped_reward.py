"""A reward of one's own that reads whatever a match has, not the ball and single numbers alone."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from fbrl.envs import make_env
from fbrl.transforms import ShapedReward


class ForwardReward(ShapedReward):
    """Pays for each metre that the own team, on average, has come forward; a goal begins anew."""

    def __init__(self, **options):
        super().__init__(
            observations=("ball", "left_team", "score"),
            parts=("reward_forward",),
            memory=("place",),
            **options,
        )

    def _first_memory(self, observation):
        return {"place": observation["left_team"][..., 0].mean(-1)}

    def _remember(self, memory, observation, scoring):
        return self._first_memory(observation)

    def _pay(self, memory, remembered, observation):
        assert observation["score"].shape == (*observation["ball"].shape[:-1], 2)
        return (54.4 * (remembered["place"] - memory["place"]),)


@pytest.fixture(scope="module")
def rollout():
    env = make_env(
        "academy_counterattack_hard",
        num_envs=2,
        reward=ForwardReward(),
        keep_keys=("ball", "left_team", "score"),
        seed=0,
    )
    check_env_specs(env, break_when_any_done="both")
    yield env.rollout(60, break_when_any_done=False)
    env.close()


def test_it_pays_for_where_the_players_are(rollout):
    went = rollout["next", "left_team"] - rollout["left_team"]
    expected = 54.4 * went[..., 0].mean(-1, keepdim=True)
    assert expected.abs().max() > 0.1
    torch.testing.assert_close(rollout["next", "reward_forward"], expected, atol=1e-4, rtol=1e-4)


def test_stored_steps_are_relabelled(rollout):
    stored = rollout.exclude("place", ("next", "place"), ("next", "reward_forward"))
    again = ForwardReward()(stored.clone())
    torch.testing.assert_close(again["next", "reward_forward"], rollout["next", "reward_forward"])
    # Without the memory the steps have to follow each other, which the players tell, too.
    stored["left_team"][0, 30, 5, 0] += 0.25
    with pytest.raises(ValueError, match=r"needs consecutive steps.*'left_team' of some step"):
        ForwardReward()(stored)


def step(**changes):
    state = TensorDict(
        ball=torch.zeros(1, 3),
        left_team=torch.zeros(1, 11, 2),
        score=torch.zeros(1, 2, dtype=torch.int64),
        batch_size=[1],
    )
    following = state.clone().set("reward", torch.zeros(1, 1)).update(changes)
    return state.set("place", torch.zeros(1)).set("next", following)


@pytest.mark.parametrize(
    ("key", "value", "error", "message"),
    [
        (
            "left_team",
            torch.zeros(1, 11, 2).int(),
            TypeError,
            r"int32, but must be floating.*\.float",
        ),
        (
            "left_team",
            torch.zeros(1, 11, 3),
            ValueError,
            r"\(1, 11, 3\), but .* needs \(1, 11, 2\)\.",
        ),
        ("score", torch.zeros(1, 2), TypeError, r"float32, but must be an integer.*\.long"),
        ("score", torch.zeros(1, 1).long(), ValueError, r"\(1, 1\), but .* needs \(1, 2\)\."),
    ],
)
def test_a_wrong_entry_is_named_with_what_is_right(key, value, error, message):
    with pytest.raises(error, match=f"in 'next': '{key}'.*{message}"):
        ForwardReward()(step(**{key: value}))


def test_only_a_single_number_can_be_absent():
    with pytest.raises(ValueError, match=r"says None for .'score'., which ForwardReward cannot do"):
        ForwardReward(keys={"score": None})
