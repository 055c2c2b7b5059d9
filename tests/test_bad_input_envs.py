"""Wrong input to environments, evaluation and policies: one clear error each."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch

from fbrl.envs import FootballEnv, FootballVectorEnv, UnknownNameError, make_env
from fbrl.evaluation.evaluation import evaluate
from fbrl.evaluation.policies import ConstantPolicy, make_policy
from fbrl.scenarios import check_scenario, expand_scenarios
from fbrl.transforms import AssistDensityReward, Simple115

SCENARIO = "academy_empty_goal"


@pytest.fixture(scope="module")
def matches():
    env = FootballVectorEnv(SCENARIO, 2)
    env.reset(seed=1)
    yield env
    env.close()


@pytest.fixture(scope="module")
def env():
    env = make_env(SCENARIO, num_envs=2, seed=0)
    yield env
    env.close()


@pytest.mark.parametrize(
    "scenario", [None, 3, True, "", ["academy_corner"], b"a", "x" * 5000, "../a"]
)
def test_a_scenario_that_there_is_not_is_refused_with_those_that_there_are(scenario):
    for use in (check_scenario, FootballEnv, FootballVectorEnv, make_env):
        with pytest.raises(UnknownNameError, match=r"There is no scenario .*academy_corner"):
            use(scenario)
    with pytest.raises(UnknownNameError, match=r"There is no scenario .*all-academy"):
        expand_scenarios(["academy_corner", str(scenario)])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"num_envs": "2"}, TypeError, "num_envs is '2'; it must be an integer of at least 1"),
        ({"num_envs": 1.5}, TypeError, "num_envs is 1.5"),
        ({"num_envs": True}, TypeError, "num_envs is True"),
        ({"num_envs": None}, TypeError, "num_envs is None"),
        ({"num_envs": float("nan")}, TypeError, "num_envs is nan"),
        ({"num_envs": -3}, ValueError, "num_envs is -3; it must be at least 1"),
        ({"num_threads": 1.5}, TypeError, "num_threads is 1.5"),
        ({"num_threads": "4"}, TypeError, "num_threads is '4'"),
        ({"action_set": None}, UnknownNameError, "no action_set None.*default, v2"),
    ],
)
def test_a_wrong_number_of_matches_or_threads_is_named(arguments, error, message):
    with pytest.raises(error, match=message):
        FootballVectorEnv(SCENARIO, **arguments)
    with pytest.raises(error, match=message):
        make_env(SCENARIO, **arguments)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"reward": None}, TypeError, "The reward is None; .* analytics, potential, checkpoints"),
        ({"reward": AssistDensityReward}, TypeError, "must be a ScoringReward"),
        ({"reward": Simple115()}, TypeError, "must be a ScoringReward"),
        ({"reward": "potential"}, TypeError, r"AssistDensityPotential\(gamma="),
        (
            {"observation": 5},
            TypeError,
            "The observation is 5; .* simple115, players, minimap, smm",
        ),
        ({"observation": AssistDensityReward()}, TypeError, "must be a Transform that writes one"),
        ({"keep_keys": "ball"}, TypeError, "keys are 'ball'; they must be a list of names"),
        ({"keep_keys": 5}, TypeError, "keys are 5"),
        ({"keep_keys": [["ball"], None]}, ValueError, "Unknown observation keys"),
        ({"seed": "a"}, ValueError, r"Seed 'a' is not an integer in \[0, 4294967295\]"),
        ({"seed": True}, ValueError, "Seed True"),
    ],
)
def test_wrong_parts_of_a_training_environment_are_named(arguments, error, message):
    with pytest.raises(error, match=message):
        make_env(SCENARIO, num_envs=1, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": 1.5}, "Seed 1.5 is neither an integer nor a list of 2 integers"),
        ({"seed": np.array(3)}, "neither an integer nor a list"),
        ({"seed": (s for s in (1, 2))}, "neither an integer nor a list"),
        ({"seed": {"a": 1, "b": 2}}, "neither an integer nor a list"),
        ({"seed": True}, "Seed True|neither"),
        ({"seed": ["a", 1]}, "Seed 'a'"),
        ({"options": "x"}, r"options of reset\(\) are 'x'; allowed: reset_mask"),
        ({"options": {"reset_maks": [True, True]}}, "allowed: reset_mask"),
        ({"options": {"reset_mask": [[1], [1, 2]]}}, "which make no array"),
        ({"options": {"reset_mask": [1, 0]}}, r"it must be boolean of shape \(2,\)"),
    ],
)
def test_a_wrong_reset_is_named(matches, arguments, message):
    with pytest.raises(ValueError, match=message):
        matches.reset(**arguments)


@pytest.mark.parametrize(
    "actions",
    [None, 5, "ab", [0], [0.0, 0.0], [True, False], [float("nan"), 0], [2**70, 0], [[1], [1, 2]]],
)
def test_wrong_actions_are_named_with_what_is_allowed(matches, actions):
    message = r"integers of shape \(2,\)|which make no array"
    with pytest.raises(ValueError, match=message):
        matches.step(actions)


def test_a_single_match_takes_neither_options_nor_a_truth_as_an_action():
    env = FootballEnv(SCENARIO)
    with pytest.raises(ValueError, match=r"options of reset\(\) are .*allowed: none"):
        env.reset(options={"reset_mask": [True]})
    env.reset(seed=1, options={})
    with pytest.raises(ValueError, match="Action True is not an integer"):
        env.step(True)
    env.close()


def test_a_closed_environment_says_so():
    for env, action in ((FootballEnv(SCENARIO), 0), (FootballVectorEnv(SCENARIO, 2), [0, 0])):
        env.reset(seed=1)
        env.close()
        for call in (lambda env=env, action=action: env.step(action), env.reset):
            with pytest.raises(RuntimeError, match="closed: make"):
                call()


STATES = {
    "too few": (lambda states: states[:1], "states of 1 matches for 2"),
    "no list": (lambda states: 5, "states of 5 matches for 2"),
    "none": (lambda states: [None, None], "State 0 is not that of a match"),
    "without a match": (lambda states: [{}, {}], "KeyError: 'match'"),
    "a field more": (lambda states: with_match(states, x=1), "unexpected keyword argument 'x'"),
    "a seed as a text": (lambda states: with_match(states, seed="1"), "seed is '1'; .* type int"),
    "a seed below 0": (lambda states: with_match(states, seed=-1), "State 0 is not"),
    "an engine's state as a text": (lambda states: with_match(states, engine="a"), "type bytes"),
    "an empty engine's state": (
        lambda states: with_match(states, engine=b""),
        "of 0 bytes, is not that of",
    ),
    "a cut one": (
        lambda states: with_match(states, engine=b"\0" * 99),
        "of 99 bytes, is not that of",
    ),
    "one too long": (
        lambda states: with_match(states, engine=bytes(10**7 + 1)),
        "bytes, is not that of",
    ),
    "one of another seed": (
        lambda states: with_match(states, seed=5),
        "engine seed 5, .* not that of",
    ),
}


def with_match(states, **changes):
    states[0]["match"].update(changes)
    return states


@pytest.mark.parametrize("case", STATES)
def test_a_state_that_the_engine_would_crash_on_is_refused(matches, case):
    matches.reset(seed=1)
    good = matches.get_state()
    change, message = STATES[case]
    with pytest.raises(ValueError, match=message):
        matches.set_state(change(copy.deepcopy(good)))
    matches.set_state(good)


def test_a_state_of_another_scenario_is_refused():
    one, other = FootballVectorEnv(SCENARIO, 1), FootballVectorEnv("academy_corner", 1)
    one.reset(seed=1)
    other.reset(seed=1)
    with pytest.raises(ValueError, match=r"academy_corner \(.* is not that of a match of this"):
        other.set_state(one.get_state())
    one.close()
    other.close()


@pytest.mark.parametrize(
    "missing", ["action", "last_ball_carrier", "play_memory", "play_statistics"]
)
def test_an_entry_that_is_missing_from_a_step_is_named(env, missing):
    state = env.reset().set("action", torch.zeros(2, dtype=torch.int64))
    with pytest.raises(KeyError, match=f"no '{missing}' in the tensordict"):
        env.step(state.exclude(missing))


@pytest.mark.parametrize(
    "action",
    [
        torch.zeros(2),
        torch.zeros(2, 1, dtype=torch.int64),
        torch.tensor([0, 19]),
        torch.zeros(2, 19),
    ],
)
def test_a_policys_wrong_action_is_named(env, action):
    state = env.reset().set("action", action)
    with pytest.raises(ValueError, match=r"integers of shape \(2,\)|not all in \[0, 18\]"):
        env.step(state)


@pytest.mark.parametrize(
    ("episodes", "policy", "error", "message"),
    [
        (0, make_policy("random"), ValueError, "episodes is 0; it must be at least 1"),
        ("2", make_policy("random"), TypeError, "episodes is '2'"),
        (2, lambda state: state, KeyError, "no 'action' in the tensordict"),
        (2, lambda state: None, TypeError, "policy returned None; it must return its tensordict"),
        (2, make_policy("builtin-ai"), ValueError, r"not all in \[0, 18\]"),
    ],
)
def test_a_wrong_evaluation_is_refused(env, episodes, policy, error, message):
    with pytest.raises(error, match=message):
        evaluate(env, policy, episodes)


def test_an_evaluation_of_something_else_is_refused():
    with pytest.raises(TypeError, match=r"The environment is a dict; .*make_env"):
        evaluate({}, make_policy("random"), 2)


@pytest.mark.parametrize(
    ("action", "error"), [(20, ValueError), (-1, ValueError), ("1", TypeError)]
)
def test_a_constant_action_that_there_is_not_is_refused(action, error):
    with pytest.raises(error, match=f"action is {action!r}"):
        ConstantPolicy(action)
