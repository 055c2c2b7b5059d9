"""Several of gfootball's steps for each action: environments, trainings, evaluations and videos."""

from __future__ import annotations

import copy
import csv
import dataclasses
import json

import gymnasium
import numpy as np
import pytest
import torch

import fbrl.cli.train
from fbrl.agent import load_agent
from fbrl.assembly import make_agent_env
from fbrl.cli.watch import main as watch
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.envs.engine import BUILTIN_AI
from fbrl.envs.factory import FootballMatches
from fbrl.evaluation.comparison import play, trained
from fbrl.run_files import CONFIG_NAME, METRICS_NAME
from fbrl.training import train
from fbrl.watch.engine_view import EngineView
from fbrl.watch.recording import record_matches
from fbrl.watch.replay_file import load_replay, save_replay

SCENARIO = "academy_counterattack_easy"
IDLE = 0
SEED_WITH_GOALS = 1
"""An engine seed with which the engine's own player scores in a full match."""


def played_one_by_one(env, action, frame_skip):
    """Plays the action and then none; returns what the last step did, with all of the reward."""
    total = 0.0
    for action_of_step in [action, *[IDLE] * (frame_skip - 1)]:
        observation, reward, terminated, truncated, _ = env.step(action_of_step)
        total += reward
        if terminated or truncated:
            break
    return observation, total, terminated, truncated


def test_torchrl_repeats_steps_where_its_own_frame_skip_is_asked_for():
    matches = FootballVectorEnv(SCENARIO, num_envs=2, observation_keys=["steps_left"])
    env = FootballMatches(matches, categorical_action_encoding=True, device="cpu", frame_skip=3)
    before = env.reset()["steps_left"]
    stepped = env.step(env.rand_action(env.reset()))
    assert (before - stepped["next", "steps_left"]).flatten().tolist() == [3, 3]


@pytest.mark.parametrize("frame_skip", [2, 3])
def test_an_action_is_pressed_once_and_the_rest_of_the_frames_go_by(frame_skip):
    skipping, single = FootballEnv(SCENARIO, frame_skip=frame_skip), FootballEnv(SCENARIO)
    random = np.random.default_rng(0)
    lengths = []
    for seed in range(4):
        observation, _ = skipping.reset(seed=seed)
        single.reset(seed=seed)
        ended, length = False, 0
        while not ended:
            action = int(random.integers(19))
            observation, *result, _ = skipping.step(action)
            expected, *expected_result = played_one_by_one(single, action, frame_skip)
            assert result == expected_result
            for key, value in expected.items():
                np.testing.assert_array_equal(observation[key], value, key)
            ended, length = result[1] or result[2], length + 1
        lengths.append(length)
    assert len(set(lengths)) > 1


def test_matches_side_by_side_skip_as_a_single_one_does():
    many = FootballVectorEnv(SCENARIO, 2, frame_skip=4)
    one = FootballEnv(SCENARIO, frame_skip=4)
    many.reset(seed=[3, 8])
    one.reset(seed=8)
    for action in (5, 9, 5, 0):
        observation, *_ = many.step(np.array([12, action]))
        expected, *_ = one.step(action)
        np.testing.assert_array_equal(observation["ball"][1], expected["ball"])
        assert observation["steps_left"][1] == expected["steps_left"]


def test_the_engines_own_player_decides_in_every_frame():
    skipping = FootballVectorEnv(SCENARIO, 1, action_set="v2", frame_skip=3)
    single = FootballVectorEnv(SCENARIO, 1, action_set="v2")
    skipping.reset(seed=[1])
    single.reset(seed=[1])
    for _ in range(5):
        observation, *_ = skipping.step(np.array([BUILTIN_AI]))
        for _ in range(3):
            expected, *_ = single.step(np.array([BUILTIN_AI]))
        np.testing.assert_array_equal(observation["left_team"], expected["left_team"])


def test_a_step_pays_for_all_of_its_frames_and_ends_with_the_match():
    scenario, frame_skip = "11_vs_11_easy_stochastic", 90  # goals don't end it, its limit does
    skipping = FootballVectorEnv(scenario, 1, action_set="v2", frame_skip=frame_skip)
    single = FootballVectorEnv(scenario, 1, action_set="v2")
    skipping.reset(seed=[SEED_WITH_GOALS])
    single.reset(seed=[SEED_WITH_GOALS])
    rewards, last_frames = [], []
    truncated = [False]
    while not truncated[0]:
        _, reward, _, truncated, _ = skipping.step(np.array([BUILTIN_AI]))
        of_frames, of_single = [], [False]
        while len(of_frames) < frame_skip and not of_single[0]:
            _, frame_reward, _, of_single, _ = single.step(np.array([BUILTIN_AI]))
            of_frames.append(frame_reward[0])
        assert reward[0] == sum(of_frames)
        assert truncated[0] == of_single[0]
        rewards.append(reward[0])
        last_frames.append(of_frames[-1])
    assert sum(map(abs, rewards)) > sum(map(abs, last_frames))
    assert len(of_frames) < frame_skip


def test_gymnasium_hands_it_on():
    env = gymnasium.make(f"fbrl/{SCENARIO}-v0", frame_skip=2)
    before = env.reset(seed=0)[0]["steps_left"].item()
    assert env.step(5)[0]["steps_left"].item() == before - 2
    assert env.metadata["render_fps"] == 5  # in real time
    many = gymnasium.make_vec(f"fbrl/{SCENARIO}-v0", num_envs=2, frame_skip=2)
    before = many.reset(seed=0)[0]["steps_left"]
    np.testing.assert_array_equal(many.step(np.array([5, 5]))[0]["steps_left"], before - 2)


def test_a_copy_skips_as_the_match_itself():
    env = FootballEnv(SCENARIO, frame_skip=3)
    before = env.reset(seed=0)[0]["steps_left"].item()
    assert copy.deepcopy(env).step(5)[0]["steps_left"].item() == before - 3


@pytest.mark.parametrize("frame_skip", [0, -1, 101, 2**40])
def test_a_frame_skip_that_is_none_is_named(frame_skip):
    with pytest.raises(ValueError, match=f"frame_skip is {frame_skip}"):
        FootballEnv(SCENARIO, frame_skip=frame_skip)
    with pytest.raises(ConfigError, match=f"frame_skip is {frame_skip}"):
        TrainConfig(SCENARIO, ppo=PPOConfig(frame_skip=frame_skip)).check()


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """A training of 1,024 frames, in two parts."""
    ppo = PPOConfig(total_frames=512, num_envs=4, num_steps=32, num_minibatches=2, frame_skip=4)
    config = TrainConfig(
        SCENARIO,
        observation="players",
        eval_episodes=0,
        run_dir=tmp_path_factory.mktemp("frame_skip") / "run",
        ppo=ppo,
    )
    assert train(config).frames == 512
    more = dataclasses.replace(config, ppo=dataclasses.replace(ppo, total_frames=1024))
    assert train(more, resume=True).frames == 1024
    return config.run_dir


def test_a_training_does_not_go_on_with_another_frame_skip(run_dir, run_main):
    printed = run_main(fbrl.cli.train.main, "--resume", run_dir, "--frame-skip", 2, code=2)
    assert "--frame-skip" in printed.err


def test_a_training_counts_gfootballs_frames(run_dir):
    with (run_dir / METRICS_NAME).open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frames"]) for row in rows] == [512, 1024]
    seconds = float(rows[0]["time/collect_seconds"]) + float(rows[0]["time/update_seconds"])
    assert float(rows[0]["time/frames_per_second"]) == pytest.approx(512 / seconds, rel=1e-3)
    assert json.loads((run_dir / CONFIG_NAME).read_text())["ppo"]["frame_skip"] == 4


def test_an_agent_plays_as_it_was_trained(run_dir):
    agent = load_agent(run_dir)
    env = make_agent_env(agent.config, num_envs=1, reward="scoring", keep_keys=["steps_left"])
    env.set_seed(0)
    state = env.reset()
    before = state["steps_left"].item()
    following = env.step(state.set("action", torch.tensor([5])))["next"]
    assert following["steps_left"].item() == before - 4
    env.close()
    options = {"episodes": 4, "seed": 1, "num_envs": 2, "greedy": False, "on_progress": lambda _: 0}
    evaluation = play(trained(run_dir, "cpu"), SCENARIO, device=torch.device("cpu"), **options)
    lengths = evaluation.matches["length"]
    assert not (lengths % 4).any()
    assert lengths.min() > 4


def test_a_recording_is_drawn_at_its_own_pace(run_dir, tmp_path, run_main):
    agent = load_agent(run_dir)
    (match,) = record_matches(
        agent.model.get_collection_policy(),
        SCENARIO,
        observation="players",
        reward="scoring",
        episodes=1,
        seed=0,
        frame_skip=4,
    )
    assert (match.frame_skip, match.seconds_per_step) == (4, pytest.approx(0.4))
    save_replay(tmp_path / "match.npz", [match])
    ((again,), _) = load_replay(tmp_path / "match.npz")
    assert again.frame_skip == 4
    before_there_was_one = tmp_path / "old.npz"
    with np.load(tmp_path / "match.npz") as arrays:
        header = json.loads(str(arrays["header"]))
        header["version"] = 1
        del header["matches"][0]["frame_skip"]
        old = {**arrays, "header": np.array(json.dumps(header))}
    np.savez(before_there_was_one, **old)
    assert load_replay(before_there_was_one)[0][0].frame_skip == 1
    # The engine that draws compares every position with the recording.
    with EngineView(320, 180) as view:
        assert len(list(view.frames(again))) == match.num_steps + 1
    printed = run_main(watch, run_dir, "--out", tmp_path / "match.gif", "--width", "320").out
    frames, seconds = printed.partition("match, ")[2].split(" frames (")
    assert float(seconds.split()[0]) == pytest.approx(int(frames) / 2.5, abs=0.1)
