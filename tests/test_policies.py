"""Policies without a network."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from fbrl.checks import UnknownNameError
from fbrl.envs import make_env
from fbrl.evaluation.evaluation import evaluate
from fbrl.evaluation.policies import make_policy
from fbrl.policy_names import POLICIES


def test_the_random_policy_takes_all_actions_equally_often_and_repeatably():
    policy = make_policy("random")
    torch.manual_seed(0)
    actions = policy(TensorDict(batch_size=[19_000]))["action"]
    counts = actions.bincount(minlength=19)
    assert len(counts) == 19
    assert 850 < counts.min() <= counts.max() < 1150
    torch.manual_seed(0)
    assert (policy(TensorDict(batch_size=[19_000]))["action"] == actions).all()


def test_the_idle_policy_does_nothing():
    assert make_policy("idle")(TensorDict(batch_size=[3]))["action"].tolist() == [0, 0, 0]


def test_the_engines_own_player_scores_where_the_idle_one_does_not():
    goals = {}
    for name in ("idle", "builtin-ai"):
        policy = make_policy(name)
        env = make_env(
            "academy_empty_goal", num_envs=2, reward="scoring", action_set=policy.action_set, seed=0
        )
        goals[name] = evaluate(env, policy, 4).goal_difference
        env.close()
    assert goals["idle"] == 0
    assert goals["builtin-ai"] >= 0.5


def test_an_unknown_policy_is_refused_with_the_known_ones():
    with pytest.raises(UnknownNameError, match="builtin-ai"):
        make_policy("builtin_ai")


def test_every_named_policy_can_be_made():
    policies = {name: make_policy(name) for name in POLICIES}
    assert [policies[name].action_set for name in POLICIES] == ["default", "default", "v2"]
