"""Simple115 against gfootball's simple115v2, on made-up and real matches."""

from __future__ import annotations

import doctest
from typing import Any

import numpy as np
import pytest
import torch
from gfootball_oracle import import_gfootball, make_gfootball_env, shoot_near_goal
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_matches import (
    SyntheticEnv,
    SyntheticVectorEnv,
    as_tensordict,
    random_match,
    raw_matches,
)
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymWrapper, TransformedEnv, step_mdp
from torchrl.envs.utils import check_env_specs

import fbrl.transforms.simple115
from fbrl.envs import FootballEnv
from fbrl.transforms import Simple115


@pytest.fixture(scope="module")
def simple115v2() -> Any:
    wrapper = import_gfootball("wrappers").Simple115StateWrapper
    return lambda raws: wrapper.convert_observation(raws, fixed_positions=True)


def make_env(env: Any) -> TransformedEnv:
    return TransformedEnv(GymWrapper(env, categorical_action_encoding=True), Simple115())


def some_matches(number: int) -> TensorDict:
    random = np.random.default_rng(0)
    return as_tensordict(*(random_match(random, 11, 1 + i) for i in range(number)))


@given(raws=st.lists(raw_matches(), min_size=1, max_size=3))
@settings(deadline=None)
def test_any_match_equals_simple115v2(simple115v2, raws):
    ours = Simple115()(as_tensordict(*raws))["simple115"]
    assert ours.dtype == torch.float32
    np.testing.assert_array_equal(ours.numpy(), simple115v2(raws))


@pytest.mark.parametrize(
    "scenario", ["academy_3_vs_1_with_keeper", "1_vs_1_easy", "11_vs_11_easy_stochastic"]
)
def test_real_matches_equal_simple115v2(simple115v2, scenario):
    ours = make_env(FootballEnv(scenario))
    theirs = make_gfootball_env(scenario, 5)
    state, raws = ours.reset(seed=5), theirs.reset()
    compared = 0
    for step in range(40):
        np.testing.assert_array_equal(state["simple115"].numpy(), simple115v2(raws)[0])
        compared += 1
        if state["done"]:
            break
        action = shoot_near_goal(step, state["ball"][0].item())
        state = step_mdp(ours.step(state.set("action", torch.tensor(action))))
        raws = theirs.step(action)[0]
    assert compared > 5


def test_nobody_active_and_nobody_on_the_ball_are_told_apart_from_player_0_and_team_0():
    raw = random_match(np.random.default_rng(0))
    raw["active"], raw["ball_owned_team"], raw["game_mode"] = -1, -1, 0
    nobody = Simple115()(as_tensordict(raw))["simple115"][0]
    assert nobody[94:].nonzero().flatten().tolist() == [0, 14]
    raw["active"], raw["ball_owned_team"] = 0, 0
    somebody = Simple115()(as_tensordict(raw))["simple115"][0]
    assert somebody[94:].nonzero().flatten().tolist() == [1, 3, 14]


def test_the_vector_is_the_same_in_any_batch_shape():
    matches = some_matches(6)
    vectors = Simple115()(matches.clone())["simple115"]
    assert torch.equal(Simple115()(matches.reshape(2, 3))["simple115"], vectors.view(2, 3, 115))
    assert torch.equal(Simple115()(matches[4])["simple115"], vectors[4])


def test_double_precision_observations_are_rounded_to_single():
    matches = some_matches(2)
    double = matches.clone().update({"ball": matches["ball"].double()})
    vectors = Simple115()(double)["simple115"]
    assert vectors.dtype == torch.float32
    assert torch.equal(vectors, Simple115()(matches)["simple115"])


@pytest.mark.parametrize("env", [SyntheticEnv(), SyntheticVectorEnv()])
def test_specs_describe_what_comes_out(env):
    transformed = make_env(env)
    check_env_specs(transformed)
    spec = transformed.observation_spec["simple115"]
    assert spec.shape == (*transformed.batch_size, 115)
    assert spec.is_in(transformed.reset()["simple115"])


def test_vectorised_matches_that_end_at_different_times_are_each_observed_right():
    rollout = make_env(SyntheticVectorEnv((2, 3, 7))).rollout(20, break_when_any_done=False)
    assert rollout["next", "done"].sum((1, 2)).tolist() == [10, 6, 2]
    recomputed = Simple115()(rollout.exclude("simple115", ("next", "simple115")))
    assert torch.equal(recomputed["simple115"], rollout["simple115"])
    assert torch.equal(recomputed["next", "simple115"], rollout["next", "simple115"])
    assert not torch.equal(rollout["simple115"][:, 1:], rollout["next", "simple115"][:, :-1])


def test_a_replay_buffer_of_raw_observations_gives_vectors():
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(6), transform=Simple115(), batch_size=4
    )
    buffer.extend(some_matches(6))
    sample = buffer.sample()
    expected = Simple115()(sample.exclude("simple115"))["simple115"]
    assert sample["simple115"].shape == (4, 115)
    assert torch.equal(sample["simple115"], expected)


def test_keys_can_be_renamed():
    match = some_matches(1)
    keys = Simple115().in_keys
    renamed = TensorDict({("raw", key): match[key] for key in keys}, batch_size=[1])
    transform = Simple115([("raw", key) for key in keys], ["vector"])
    assert torch.equal(transform(renamed)["vector"], Simple115()(match)["simple115"])


def test_wrong_input_is_named_with_its_remedy():
    match = some_matches(1)
    with pytest.raises(KeyError, match=r"Simple115: 'game_mode' is missing.*in_keys"):
        Simple115()(match.exclude("game_mode"))
    flat = match.clone().set("left_team", match["left_team"].flatten(1))
    with pytest.raises(ValueError, match=r"'left_team' has shape \(1, 22\).*\(1, 11, 2\)"):
        Simple115()(flat)
    floats = match.clone().set("ball_owned_team", torch.zeros(1))
    with pytest.raises(TypeError, match=r"'ball_owned_team' has dtype torch.float32"):
        Simple115()(floats)
    with pytest.raises(ValueError, match="in_keys must name 9 keys"):
        Simple115(in_keys=["ball"])


def test_documented_examples_run():
    outcome = doctest.testmod(fbrl.transforms.simple115)
    assert outcome.attempted > 0
    assert outcome.failed == 0
