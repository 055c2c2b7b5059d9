"""The TorchRL environment of the matches against TorchRL's own wrapper."""

from __future__ import annotations

import doctest

import pytest
import torch
from torchrl.envs import GymWrapper, step_mdp
from torchrl.envs.utils import check_env_specs

import fbrl.envs.factory
from fbrl.envs import FootballVectorEnv
from fbrl.envs.factory import FootballMatches


@pytest.fixture
def wrapped():
    """A function that wraps three matches, which are closed after the test."""
    environments = []

    def wrap(wrapper):
        matches = FootballVectorEnv("academy_3_vs_1_with_keeper", num_envs=3)
        environments.append(wrapper(matches, categorical_action_encoding=True, device="cpu"))
        return environments[-1]

    yield wrap
    for environment in environments:
        environment.close()


def rollout(environment, steps):
    environment.set_seed(5)
    torch.manual_seed(0)
    return environment.rollout(steps, break_when_any_done=False)


def test_a_rollout_is_the_one_of_torchrls_wrapper_across_the_ends_of_episodes(wrapped):
    expected, result = (rollout(wrapped(kind), 100) for kind in (GymWrapper, FootballMatches))
    assert expected["next", "done"].sum() >= 3
    assert set(result.keys(True, True)) == set(expected.keys(True, True))
    for key, values in expected.items(True, True):
        assert result[key].dtype == values.dtype, key
        assert torch.equal(result[key], values), key


def test_specs_are_those_of_torchrls_wrapper_and_hold(wrapped):
    expected, environment = wrapped(GymWrapper), wrapped(FootballMatches)
    assert environment.specs == expected.specs
    check_env_specs(environment)


def test_a_step_leaves_the_one_before_as_it_was(wrapped):
    environment = wrapped(FootballMatches)
    step = environment.rand_step(environment.reset())
    kept = step.clone()
    following = environment.rand_step(step_mdp(step))
    assert not torch.equal(following["next", "left_team"], kept["next", "left_team"])
    assert (step == kept).all()


def test_documented_examples_run():
    outcome = doctest.testmod(fbrl.envs.factory)
    assert outcome.attempted > 0
    assert outcome.failed == 0
