"""Batches of native matches: the numbers of single steps, groups in turn, states, faults."""

from __future__ import annotations

import signal

import pytest
import torch

from fbrl.collect import MatchCollector, RolloutCollector
from fbrl.envs import OBSERVATION_SPACE, make_env
from fbrl.envs.engine import load_gfootball
from fbrl.models.actor_critic import build_actor_critic
from fbrl.transforms import AssistDensityPotential, AssistDensityReward

SCENARIO = "academy_3_vs_1_with_keeper"


def make_policy(observation="simple115"):
    torch.manual_seed(0)
    return build_actor_critic(observation).get_collection_policy()


def collect(collector, num_batches):
    torch.manual_seed(1)
    batches = [collector.collect().clone() for _ in range(num_batches)]
    collector.close()
    return batches


@pytest.mark.parametrize(
    ("reward", "observation"),
    [
        ("analytics", "simple115"),
        ("analytics", "players"),
        ("checkpoints", "minimap"),
        ("scoring", "smm"),
        (AssistDensityPotential(gamma=0.9), "simple115"),
        (AssistDensityReward(episode_cap=0.005, release_at_goal=True), "simple115"),
    ],
)
def test_a_batch_has_the_numbers_of_single_steps(reward, observation):
    # With planes come the cells that they are drawn from, which a network reads sooner.
    policy = make_policy("minimap" if observation == "smm" else observation)
    arguments = {"num_envs": 3, "observation": observation, "reward": reward, "seed": 5}
    batches = collect(MatchCollector(SCENARIO, policy, num_steps=50, num_groups=1, **arguments), 4)
    expected = collect(RolloutCollector(make_env(SCENARIO, **arguments), policy, 50), 4)

    ends = torch.cat([batch["next", "done"] for batch in batches], 1)
    assert ends.sum() >= 3, "matches end, also in the middle of batches"
    for batch, single_steps in zip(batches, expected, strict=True):
        for key, value in single_steps["next"].items():
            if key != "play_memory":
                torch.testing.assert_close(
                    batch["next", key], value, rtol=0, atol=0, msg=f"{key} differs"
                )
        assert not set(OBSERVATION_SPACE) & {*batch.keys(), *batch["next"].keys()}
        for key in (*policy.in_keys, "action", "action_log_prob", "state_value"):
            assert torch.equal(batch[key], single_steps[key])


@pytest.mark.parametrize("num_groups", [2, 3, 9])
def test_groups_that_take_turns_have_the_batches_of_one(num_groups):
    policy = make_policy()
    arguments = {"num_envs": 5, "num_steps": 60, "seed": 2}
    one = collect(MatchCollector(SCENARIO, policy, num_groups=1, **arguments), 2)
    groups = collect(MatchCollector(SCENARIO, policy, num_groups=num_groups, **arguments), 2)
    for batch, expected in zip(groups, one, strict=True):
        assert torch.equal(batch["action"], expected["action"])
        assert torch.equal(batch["next", "simple115"], expected["next", "simple115"])
        torch.testing.assert_close(batch["state_value"], expected["state_value"])


def test_a_state_goes_on_with_the_same_batches_also_after_one_that_was_broken_off(monkeypatch):
    collector = MatchCollector(SCENARIO, make_policy(), num_envs=3, num_steps=40, num_groups=2)
    collector.collect()
    state, random_numbers = collector.state_dict(), torch.get_rng_state()
    expected = [collector.collect().clone() for _ in range(3)]

    look, steps = MatchCollector._look, []

    def interrupt(self, group, step):
        steps.append(step)
        if len(steps) == 31:
            raise KeyboardInterrupt
        look(self, group, step)

    with monkeypatch.context() as context:
        context.setattr(MatchCollector, "_look", interrupt)
        with pytest.raises(KeyboardInterrupt):
            collector.collect()
    collector.load_state_dict(state)
    torch.set_rng_state(random_numbers)
    for batch in expected:
        assert (collector.collect() == batch).all()
    collector.close()


def test_a_signal_is_heard_while_matches_hang():
    collector = MatchCollector(SCENARIO, make_policy(), num_envs=2, num_steps=8)
    collector.collect()
    engine = load_gfootball().engine
    collector.disturb(engine.Disturbance("sleep", seconds=2))
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    with pytest.raises(KeyboardInterrupt):
        collector.collect()
    collector.close()


def test_a_match_that_fails_is_named():
    collector = MatchCollector(SCENARIO, make_policy(), num_envs=2, num_steps=8, seed=1)
    collector.reset()
    seed, _ = collector._matches.episodes[1]
    engine = load_gfootball().engine
    collector.disturb(engine.Disturbance("throw", engine_seed=seed))
    with pytest.raises(RuntimeError, match=rf"match 1 of {SCENARIO} \(engine seed {seed}, episode"):
        collector.collect()
    collector.close()
