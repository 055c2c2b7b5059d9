"""The network that reads players as sets."""

from __future__ import annotations

import pytest
import torch

from fbrl.envs import make_env
from fbrl.models import PlayerSet, build_actor_critic
from fbrl.transforms import PLAYERS_FEATURES

NAMES = list(PLAYERS_FEATURES)


@pytest.fixture
def states() -> torch.Tensor:
    """Of a match of eleven a side and of one of four against two."""
    torch.manual_seed(0)
    found = []
    for scenario in ("academy_counterattack_hard", "academy_3_vs_1_with_keeper"):
        env = make_env(scenario, num_envs=2, observation="players", seed=0)
        found.append(env.rollout(20, break_when_any_done=False)["players"].flatten(0, 1))
        env.close()
    return torch.cat(found)


def columns(who: str, number: int) -> list[int]:
    return [i for i, name in enumerate(NAMES) if name.startswith(f"{who}_{number}_")]


@pytest.mark.parametrize(("who", "number"), [("mate", 10), ("opponent", 11)])
def test_the_order_of_the_players_makes_no_difference(states, who, number):
    shuffled = states.clone()
    order = torch.randperm(number).tolist()
    assert order != list(range(number))
    for place, other in enumerate(order):
        shuffled[:, columns(who, place + 1)] = states[:, columns(who, other + 1)]
    network = PlayerSet()
    assert not torch.equal(shuffled, states)
    torch.testing.assert_close(network(shuffled), network(states), rtol=1e-4, atol=1e-4)


def test_each_player_who_is_there_makes_a_difference_and_no_other(states):
    network = PlayerSet()
    features = network(states)
    for who, number in (("mate", 10), ("opponent", 11)):
        for place in range(1, number + 1):
            moved = states.clone()
            moved[:, columns(who, place)[1]] += 1
            is_there = states[:, columns(who, place)[0]] == 1
            is_other = (network(moved) - features).abs().amax(-1) > 1e-4
            assert torch.equal(is_other, is_there), (who, place)


def test_it_is_built_by_name_and_trained_as_any_other(states):
    model = build_actor_critic("players", network="player_set", hidden_sizes=(64, 32))
    assert model.get_value_head().module.in_features == 32
    model.get_value_operator().module[0].module(states).sum().backward()
    trunk = model.get_collection_policy().trunk
    assert isinstance(trunk, PlayerSet)
    assert all(parameter.grad.abs().max() > 0 for parameter in trunk.parameters())


def test_wrong_choices_are_named_with_the_right_ones():
    with pytest.raises(ValueError, match=r"no network 'gnn'.*player_set"):
        build_actor_critic("players", network="gnn")
    with pytest.raises(ValueError, match="player_set reads players"):
        build_actor_critic("simple115", network="player_set")
    with pytest.raises(ValueError, match="embedding_size is 0"):
        PlayerSet(embedding_size=0)
    with pytest.raises(ValueError, match=r"shape \(2, 115\); it must be .*274"):
        PlayerSet()(torch.zeros(2, 115))
