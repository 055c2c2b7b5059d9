"""FootballEnv against gfootball's own environment, and against Gymnasium's and TorchRL's checks."""

from __future__ import annotations

import copy
import os
import random
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from conftest import needs_engine
from gfootball_oracle import import_gfootball, make_gfootball_env, pad, shoot_near_goal
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import TimeAwareObservation
from torchrl.envs import GymEnv
from torchrl.envs.utils import check_env_specs

import fbrl
from fbrl.envs import SCENARIOS, FootballEnv, FootballVectorEnv, UnknownNameError
from fbrl.envs.engine import build_scenario, load_gfootball

FORCED_PASS_AFTER = 20


def play_side_by_side(scenario, seed, policy, episodes, max_steps):
    """Plays the same actions in both environments and compares all that they return.

    Returns what happened, so that a test can make sure that its case was really met.
    """
    ours = FootballEnv(scenario)
    theirs = make_gfootball_env(scenario, seed)
    happened = {"rewards": [], "ends": [], "longest_wait": 0, "padded": 0}
    for episode in range(episodes):
        # gfootball with a pinned seed repeats the episode, apart from the side that kicks off.
        if episode == 0:
            observation, _ = ours.reset(seed=seed)
        else:
            ours._matches.prepare(0, seed, ours._episode_number + episode)
            ours._matches.begin([0])
            observation = ours._observe()
        raw = theirs.reset()[0]
        for step in range(max_steps):
            assert set(observation) == set(raw)
            for key, value in raw.items():
                expected = pad(key, value)
                happened["padded"] += expected.shape != np.shape(value)
                np.testing.assert_array_equal(
                    observation[key], expected.astype(observation[key].dtype), key
                )
            action = policy(step, raw["ball"][0])
            observation, reward, terminated, truncated, _ = ours.step(action)
            (raw,), (expected_reward,), done, _ = theirs.step(action)
            assert reward == expected_reward
            assert (terminated or truncated) == done
            happened["rewards"].append(reward)
            has_ended = terminated or truncated
            waited = 0 if has_ended else ours._matches.get_state(0).waiting_steps
            happened["longest_wait"] = max(happened["longest_wait"], waited)
            if done:
                assert truncated == (raw["steps_left"] == 0 and not terminated)
                happened["ends"].append("truncated" if truncated else "terminated")
                break
    ours.close()
    theirs.close()
    return happened


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda step, ball_x: int(rng.integers(19))


def idle(step, ball_x):
    return 0


@pytest.mark.parametrize("seed", [1, 2, 4_294_967_295])
def test_agrees_with_gfootball_where_lost_possession_ends_the_episode(seed):
    happened = play_side_by_side(
        "academy_3_vs_1_with_keeper", seed, random_policy(seed), episodes=3, max_steps=400
    )
    assert happened["ends"] == ["terminated"] * 3
    assert happened["padded"] > 0


def test_agrees_with_gfootball_where_a_goal_ends_the_episode():
    happened = play_side_by_side("academy_empty_goal", 3, shoot_near_goal, 2, 400)
    assert happened["ends"] == ["terminated"] * 2
    assert happened["rewards"].count(1.0) == 2


def test_agrees_with_gfootball_on_a_counterattack():
    for seed in (5, 6):
        happened = play_side_by_side(
            "academy_counterattack_hard", seed, random_policy(seed), 2, 400
        )
        assert "terminated" in happened["ends"]


def test_agrees_with_gfootball_on_a_corner_that_only_ends_out_of_play():
    happened = play_side_by_side("academy_corner", 7, random_policy(7), 2, 400)
    assert len(happened["ends"]) == 2


def test_agrees_with_gfootball_on_a_small_sided_match_up_to_its_time_limit():
    happened = play_side_by_side("1_vs_1_easy", 2, random_policy(2), 2, 600)
    assert happened["ends"] == ["truncated"] * 2
    assert -1.0 in happened["rewards"]


@pytest.mark.parametrize(
    ("scenario", "seed", "policy"),
    [
        ("11_vs_11_easy_stochastic", 4, shoot_near_goal),
        ("11_vs_11_easy_stochastic", 7, shoot_near_goal),
        ("11_vs_11_hard_stochastic", 2, idle),
    ],
)
def test_agrees_with_gfootball_across_the_kick_off_after_a_goal(scenario, seed, policy):
    happened = play_side_by_side(scenario, seed, policy, episodes=1, max_steps=200)
    goals = np.flatnonzero(happened["rewards"])
    assert len(goals) > 0
    assert len(happened["rewards"]) > goals[0] + 20


def test_agrees_with_gfootball_on_either_side_of_the_kick_off():
    play_side_by_side("11_vs_11_easy_stochastic", 9, random_policy(9), episodes=2, max_steps=60)


def test_agrees_with_gfootball_where_waiting_forces_an_action():
    happened = play_side_by_side("11_vs_11_easy_stochastic", 2, idle, 1, 500)
    assert happened["longest_wait"] > FORCED_PASS_AFTER


def test_agrees_with_gfootball_where_waiting_goes_on_past_thirty_steps():
    def run_right_and_shoot(step, ball_x):
        return [5, 13, 12][step % 3]

    happened = play_side_by_side("5_vs_5", 2, run_right_and_shoot, 1, 700)
    assert happened["longest_wait"] > 30


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_agrees_with_gfootball_on_every_scenario(scenario):
    play_side_by_side(scenario, 11, random_policy(11), episodes=2, max_steps=40)


@needs_engine
def test_agrees_with_gfootball_on_a_scenario_outside_the_table():
    play_side_by_side("tests.11_vs_4_offence_deterministic", 1, random_policy(1), 1, 60)


def test_the_scenario_table_equals_gfootball():
    gfootball = load_gfootball()
    shipped = set(import_gfootball("scenario_builder").all_scenarios()) - {"tests"}
    assert set(SCENARIOS) == shipped
    for name, scenario in SCENARIOS.items():
        by_episode = [
            gfootball.config.Config(
                {"level": name, "game_engine_random_seed": 1, "episode_number": number}
            ).ScenarioConfig()
            for number in (0, 1)
        ]
        config = by_episode[0]
        assert scenario.left_players == len(config.left_team)
        assert scenario.right_players == len(config.right_team)
        assert scenario.duration == config.game_duration
        assert scenario.right_difficulty == pytest.approx(config.right_team_difficulty)
        assert scenario.ends_on_score == config.end_episode_on_score
        assert scenario.ends_on_out_of_play == config.end_episode_on_out_of_play
        assert scenario.ends_on_possession_change == config.end_episode_on_possession_change
        first_x = [max(p.position[0] for p in config.left_team) for config in by_episode]
        is_match = scenario.duration != 400 and not scenario.ends_on_score
        assert scenario.alternating_kick_off == is_match
        if len(config.left_team) > 1:
            assert scenario.alternating_kick_off == (first_x[0] != first_x[1])


@pytest.mark.parametrize("scenario", ["academy_3_vs_1_with_keeper", "11_vs_11_easy_stochastic"])
def test_passes_gymnasiums_checks(scenario):
    env = gymnasium.make(f"fbrl/{scenario}-v0")
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_passes_torchrls_checks():
    env = GymEnv("fbrl/academy_pass_and_shoot_with_keeper-v0", categorical_action_encoding=True)
    check_env_specs(env)
    env.close()


def test_every_scenario_is_registered_with_its_time_limit():
    for name, scenario in SCENARIOS.items():
        spec = gymnasium.spec(f"fbrl/{name}-v0")
        assert spec.max_episode_steps == scenario.duration + 1
        assert spec.kwargs == {"scenario": name}
        assert not spec.nondeterministic


def test_a_registered_match_ends_when_the_match_itself_does():
    made = gymnasium.make("fbrl/1_vs_1_easy-v0")
    made = TimeAwareObservation(made, flatten=False, normalize_time=False)
    bare = FootballEnv("1_vs_1_easy")
    made.reset(seed=3)
    bare.reset(seed=3)
    done, steps = False, 0
    while not done:
        steps += 1
        action = [5, 1, 12, 9][steps % 4]
        observation, *result, _ = made.step(action)
        assert result == list(bare.step(action)[1:4])
        assert int(observation["time"][0]) == steps
        done = any(result[1:])
    assert result[1:] == [False, True]
    assert steps == 501
    assert observation["steps_left"] == 0
    made.close()
    bare.close()


def test_the_observation_is_as_documented():
    env = FootballEnv("academy_3_vs_1_with_keeper")
    observation, info = env.reset(seed=4)
    assert info == {"engine_seed": 4}
    assert env.observation_space.contains(observation)
    assert all(space.shape for space in env.observation_space.values())
    assert (observation["left_team_roles"] >= 0).sum() == 4
    assert (observation["right_team_roles"] >= 0).sum() == 2
    assert (observation["left_team"][4:] == -1).all()
    assert (observation["left_team_direction"][4:] == -1).all()
    assert not observation["left_team_active"][4:].any()
    env.close()


def test_fewer_keys_can_be_observed():
    whole = FootballEnv("academy_empty_goal")
    part = FootballEnv("academy_empty_goal", observation_keys=["ball", "score"])
    expected, _ = whole.reset(seed=1)
    observation, _ = part.reset(seed=1)
    assert set(observation) == {"ball", "score"} == set(part.observation_space)
    np.testing.assert_array_equal(observation["ball"], expected["ball"])
    with pytest.raises(ValueError, match=r"bal.*there are.*ball"):
        FootballEnv("academy_empty_goal", observation_keys=["bal"])
    whole.close()
    part.close()


def rollout(env, seed, steps=60):
    observations = [env.reset(seed=seed)[0]["ball"]]
    seeds = []
    rng = np.random.default_rng(0)
    for _ in range(steps):
        observation, _, terminated, truncated, _ = env.step(rng.integers(19))
        if terminated or truncated:
            observation, info = env.reset()
            seeds.append(info["engine_seed"])
        observations.append(observation["ball"])
    return np.array(observations), seeds


def test_the_same_seed_gives_the_same_episodes_whatever_came_before():
    env = FootballEnv("academy_3_vs_1_with_keeper")
    first, first_seeds = rollout(env, 5, steps=400)
    other, _ = rollout(env, 6, steps=400)
    again, again_seeds = rollout(env, 5, steps=400)
    np.testing.assert_array_equal(first, again)
    assert first_seeds == again_seeds
    assert len(set(first_seeds)) == len(first_seeds) > 1
    assert not np.array_equal(first, other)
    env.close()


def test_both_processing_orders_occur_in_one_environment():
    env = FootballEnv("academy_empty_goal_close")
    env.reset(seed=0)
    orders = set()
    for _ in range(20):
        _, info = env.reset()
        config = build_scenario(env.scenario, *env._matches.episodes[0])
        order = config.reverse_team_processing
        assert order == bool(info["engine_seed"] % 2)
        orders.add(order)
    assert orders == {False, True}
    env.close()


def test_pythons_global_random_state_is_left_alone():
    random.seed(1)
    np.random.seed(1)
    before, numpy_before = random.getstate(), np.random.get_state()[1].copy()
    env = FootballEnv("academy_empty_goal_close")
    env.reset(seed=1)
    env.step(5)
    env.reset()
    assert random.getstate() == before
    np.testing.assert_array_equal(np.random.get_state()[1], numpy_before)
    env.close()


@needs_engine
def test_no_gym_banner_and_no_gym_module():
    program = (
        "import sys; from fbrl.envs import FootballEnv; "
        "FootballEnv('academy_empty_goal').reset(seed=1); "
        "assert 'gym' not in sys.modules and 'pygame' not in sys.modules; "
        "import gymnasium; assert not [i for i in gymnasium.registry if 'GFootball' in i]"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_fbrl_imports_without_gfootball(tmp_path):
    (tmp_path / "fbrl_engine.py").write_text("raise ImportError('hidden for the test')")
    program = (
        "import fbrl, fbrl.envs, fbrl.transforms, fbrl.density\n"
        "try:\n    fbrl.envs.FootballEnv('academy_empty_goal')\n"
        "except fbrl.envs.EngineNotInstalledError as error:\n    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "hidden for the test" in done.stdout
    assert "make setup" in done.stdout


@pytest.mark.parametrize("action", [19, -1, 2.0, None, "shot", np.array([1])])
def test_an_action_out_of_range_is_named(action):
    env = FootballEnv("academy_empty_goal")
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"not an integer in \[0, 18\]"):
        env.step(action)
    env.close()


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, "1"])
def test_a_seed_out_of_range_is_named(seed):
    env = FootballEnv("academy_empty_goal")
    with pytest.raises(ValueError, match=r"Seed .* is not an integer in \[0, 4294967295\]"):
        env.reset(seed=seed)
    env.close()


def test_stepping_before_a_reset_or_after_the_end_says_what_to_do():
    env = FootballEnv("academy_empty_goal")
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(0)
    env.reset(seed=3)
    done = False
    step = 0
    while not done:
        _, _, terminated, truncated, _ = env.step(shoot_near_goal(step, 0.0))
        done, step = terminated or truncated, step + 1
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(0)
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_an_unknown_scenario_is_answered_with_the_nearest_names():
    with pytest.raises(UnknownNameError, match="academy_counterattack_hard"):
        FootballEnv("academy_counteratack_hard")
    with pytest.raises(UnknownNameError):
        FootballEnv("tests")
    with pytest.raises(UnknownNameError):
        FootballEnv("../env/config")


def test_version_is_that_of_the_package():
    from importlib.metadata import version

    assert fbrl.__version__ == version("fbrl")


def test_a_copy_goes_on_as_the_match_itself_and_leaves_it_alone():
    env = gymnasium.make("fbrl/academy_3_vs_1_with_keeper-v0", disable_env_checker=True)
    env.reset(seed=5)
    for action in (5, 5, 11):
        env.step(action)
    other = copy.deepcopy(env)
    assert other.unwrapped is not env.unwrapped
    assert other.spec == env.spec
    futures = []
    for match in (other, env):
        steps = []
        for _ in range(600):
            observation, reward, terminated, truncated, info = match.step(len(steps) % 19)
            steps.append((observation["ball"].tolist(), reward, terminated, truncated, info))
            if terminated or truncated:
                match.reset()
        futures.append(steps)
        match.close()
    assert futures[0] == futures[1]
    assert len({info["engine_seed"] for *_, info in futures[0]}) > 1, "no episode began after it"


def test_a_copy_of_an_ended_match_begins_with_a_reset():
    env = FootballEnv("academy_empty_goal_close")
    other = copy.deepcopy(env)
    env.reset(seed=2)
    assert other.reset(seed=2)[0]["ball"].tolist() == env.reset(seed=2)[0]["ball"].tolist()
    env.close()
    other.close()


def test_a_state_of_something_else_is_refused():
    env, other = FootballEnv("academy_empty_goal_close"), FootballEnv("academy_corner")
    other.reset(seed=1)
    state = other.get_state()
    for bad in (state, {}, {**state, "match": {**state["match"], "engine": b"1"}}):
        with pytest.raises(ValueError, match="not that of a match"):
            env.set_state(bad)
    env.reset(seed=1)
    env.close()
    other.close()


def test_matches_of_a_vector_environment_name_what_to_do_instead_of_a_copy():
    env = FootballVectorEnv("academy_empty_goal_close", 2)
    with pytest.raises(TypeError, match=r"get_state\(\) with set_state"):
        copy.deepcopy(env)
    env.close()
