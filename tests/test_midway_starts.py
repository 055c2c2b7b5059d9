"""Matches that begin in states which earlier ones came to."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fbrl.collect import MatchCollector
from fbrl.config import ConfigError, TrainConfig
from fbrl.envs import FootballVectorEnv
from fbrl.envs.matches import KEPT_STATES, MidwayStarts
from fbrl.models.actor_critic import build_actor_critic
from fbrl.monitor.recent_matches import RecentMatches
from fbrl.transforms import ScoringReward

SCENARIO = "academy_3_vs_1_with_keeper"
RIGHT = 5


@pytest.fixture
def matches():
    env = FootballVectorEnv(SCENARIO, 2, observation_keys=["ball", "steps_left"])
    env.reset(seed=3)
    yield env
    env.close()


def play(env, steps):
    for _ in range(steps):
        observation, _, terminated, truncated, _ = env.step(np.full(env.num_envs, RIGHT))
        assert not (terminated | truncated).any()
    return observation


def test_an_episode_begins_where_an_earlier_one_was_and_goes_on_as_that_did(matches):
    kept = play(matches, 6)
    states = matches.match_states()
    expected = play(matches, 3)
    matches.begin_from(lambda engine_seed: states[0])
    begun, _ = matches.reset()
    assert matches.begun_midway.all()
    for match in range(2):
        assert all(np.array_equal(begun[key][match], kept[key][0]) for key in begun)
    again = play(matches, 3)
    assert np.array_equal(again["ball"][1], expected["ball"][0])


def test_an_episode_with_a_seed_of_its_own_begins_at_its_beginning(matches):
    first, _ = matches.reset(seed=3)
    play(matches, 5)
    states = matches.match_states()
    matches.begin_from(lambda engine_seed: states[0])
    begun, _ = matches.reset(seed=3)
    assert not matches.begun_midway.any()
    assert np.array_equal(begun["ball"], first["ball"])


def test_where_nothing_is_chosen_the_episodes_are_those_of_always(matches):
    first = [matches.reset()[0]["ball"] for _ in range(3)]
    matches.reset(seed=3)
    matches.begin_from(lambda engine_seed: None)
    again = [matches.reset()[0]["ball"] for _ in range(3)]
    assert np.array_equal(first, again)


def test_the_asked_share_begins_midway_and_only_the_latest_states_are_kept(matches):
    starts = MidwayStarts(0.25)
    assert starts.choose(1) is None, "there is no state yet"
    play(matches, 3)
    starts.keep(matches.match_states())
    chosen = [starts.choose(seed) for seed in range(2000)]
    assert 0.2 < np.mean([start is not None for start in chosen]) < 0.3
    assert {start for start in chosen if start} == set(starts.kept())
    assert chosen == [starts.choose(seed) for seed in range(2000)]

    play(matches, 1)
    latest = matches.match_states()
    starts.keep(latest * (KEPT_STATES // 2))
    assert set(starts.kept()) == set(latest)


def make_collector(midway_starts):
    torch.manual_seed(0)
    policy = build_actor_critic("simple115").get_collection_policy()
    return MatchCollector(
        SCENARIO,
        policy,
        num_envs=3,
        num_steps=80,
        reward="scoring",
        midway_starts=midway_starts,
        seed=4,
    )


def test_matches_that_began_midway_are_marked_and_no_figures_count_them():
    collector, recent = make_collector(1.0), RecentMatches(ScoringReward().part_names)
    ended = ordinary = 0
    for batch_number in range(10):
        batch = collector.collect()
        done, midway = batch["next", "done"].squeeze(-1), batch["next", "begun_midway"]
        assert batch_number > 0 or not midway.any()
        ended += int(done.sum())
        ordinary += int((done & ~midway).sum())
        recent.add(batch)
        # From a match's end on, the next one is played.
        for match in range(3):
            for step in done[match, :-1].nonzero().flatten().tolist():
                assert midway[match, step + 1] == (batch_number > 0)
    collector.close()
    assert 0 < ordinary < ended
    assert recent.means()["match/count"] == ordinary


def test_batches_go_on_exactly_from_a_state():
    collector = make_collector(0.5)
    for _ in range(3):
        collector.collect()
    state, random_numbers = collector.state_dict(), torch.get_rng_state()
    expected = [collector.collect().clone() for _ in range(3)]
    assert torch.cat([batch["next", "begun_midway"] for batch in expected]).any()
    other = make_collector(0.5)
    other.load_state_dict(state)
    torch.set_rng_state(random_numbers)
    for batch in expected:
        assert (other.collect() == batch).all()
    collector.close()
    other.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"midway_starts": -0.1}, r"midway_starts is -0.1; it must be in \[0, 1\]"),
        ({"midway_starts": 1.5}, r"midway_starts is 1.5; it must be in \[0, 1\]"),
        ({"midway_starts": float("nan")}, "midway_starts is nan"),
        ({"midway_starts": 0.5, "collector": "ray"}, "only used with the collector threads"),
    ],
)
def test_a_share_that_can_not_be_is_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        TrainConfig(SCENARIO, **options).check()


def test_a_collector_refuses_a_share_that_is_none():
    with pytest.raises(ValueError, match="midway_starts is 2; it must be"):
        make_collector(2)
