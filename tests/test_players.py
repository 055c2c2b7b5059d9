"""The observation players against its table written out, on made-up and real matches."""

from __future__ import annotations

import doctest
import itertools

import numpy as np
import pytest
import torch
from players_oracle import players_by_name
from synthetic_matches import padded, random_match
from tensordict import TensorDict
from torchrl.envs import Compose, GymWrapper, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

import fbrl.transforms.players
from fbrl.envs import ACTION_NAMES, OBSERVATION_SPACE, FootballEnv, make_env
from fbrl.transforms import PLAYERS_FEATURES, ActionMemory, EngineActionMask, Players

NAMES = list(PLAYERS_FEATURES)


def made_up_match(seed: int) -> dict[str, np.ndarray]:
    """Any number of players on either side, some sent off; in some nobody is controlled."""
    random = np.random.default_rng(seed)
    numbers = {"left_team": int(random.integers(1, 12)), "right_team": int(random.integers(0, 12))}
    raw = padded(random_match(random, *numbers.values()))
    for team, number in numbers.items():
        is_there = np.zeros(11, np.int8)
        is_there[:number] = random.random(number) < 0.9
        raw[f"{team}_active"] = is_there
        raw[f"{team}_tired_factor"] = random.random(11, np.float32) * is_there
    if raw["active"] >= 0:
        raw["left_team_active"][raw["active"]] = 1
    owner = int(raw["ball_owned_team"])
    players = numbers[("left_team", "right_team")[owner]] if owner >= 0 else 0
    if not players:
        raw["ball_owned_team"] = np.array(-1)
    raw["ball_owned_player"] = random.integers(players) if players else np.array(-1)
    raw["designated"] = random.integers(-1, numbers["left_team"])
    raw["score"] = random.integers(0, 6, 2)
    raw["steps_left"] = random.integers(0, 3001)
    raw["sticky_actions"] = random.integers(0, 2, 10).astype(np.int8)
    return {key: np.asarray(value) for key, value in raw.items()}


def made_up_memory(seed: int) -> tuple[int, int, int]:
    random = np.random.default_rng(seed)
    kick = int(random.choice([-1, 9, 10, 11, 12]))
    return int(random.integers(-1, 19)), kick, int(random.integers(0, 30)) if kick >= 0 else 100


def as_batch(matches, memories) -> TensorDict:
    entries = {key: np.stack([match[key] for match in matches]) for key in matches[0]}
    return TensorDict(
        {**entries, "action_memory": torch.tensor(memories)}, batch_size=[len(matches)]
    )


def has_tie(numbers: torch.Tensor) -> bool:
    """Whether two players are as far away, as at kick-offs: rounding decides who comes first."""
    distances = [
        [numbers[NAMES.index(f"{who}_{slot}_distance")].item() for slot in range(1, slots + 1)]
        for who, slots in (("mate", 10), ("opponent", 11))
    ]
    return any(
        after and after - before < 1e-4
        for team in distances
        for before, after in itertools.pairwise(team)
    )


def assert_as_written(vector: torch.Tensor, raw, memory) -> None:
    expected = players_by_name(raw, memory)
    assert set(expected) == set(NAMES)
    for name, number in zip(NAMES, vector.tolist(), strict=True):
        assert number == pytest.approx(expected[name], rel=2e-4, abs=2e-5), name


def test_any_match_is_told_as_the_table_says():
    seeds = range(300)
    matches, memories = map(made_up_match, seeds), map(made_up_memory, seeds)
    matches, memories = list(matches), list(memories)
    vectors = Players()(as_batch(matches, memories))["players"]
    assert vectors.dtype == torch.float32
    for vector, raw, memory in zip(vectors, matches, memories, strict=True):
        assert_as_written(vector, raw, memory)


@pytest.mark.parametrize(
    "scenario",
    ["academy_3_vs_1_with_keeper", "1_vs_1_easy", "5_vs_5", "11_vs_11_easy_stochastic"],
)
def test_real_matches_are_told_as_the_table_says(scenario):
    env = make_env(scenario, num_envs=2, observation="players", keep_keys=OBSERVATION_SPACE, seed=0)
    torch.manual_seed(0)
    data = env.rollout(60, break_when_any_done=False)
    env.close()
    actions, done = data["action"].tolist(), data["next", "done"].squeeze(-1).tolist()
    compared = 0
    for match in range(2):
        memory = (-1, -1, 100)
        for step in range(60):
            state = data[match, step]
            raw = {key: state[key].numpy() for key in OBSERVATION_SPACE}
            if not has_tie(state["players"]):
                assert_as_written(state["players"], raw, memory)
                compared += 1
            action = actions[match][step]
            is_kick = 9 <= action <= 12
            kick, steps = (action, 0) if is_kick else (memory[1], min(memory[2] + 1, 100))
            memory = (-1, -1, 100) if done[match][step] else (action, kick, steps)
    assert compared > 90


@pytest.mark.parametrize(
    "scenario",
    ["academy_3_vs_1_with_keeper", "academy_counterattack_hard", "11_vs_11_easy_stochastic"],
)
def test_every_number_is_of_about_unit_size(scenario):
    env = make_env(scenario, num_envs=4, observation="players", seed=1)
    torch.manual_seed(0)
    vectors = env.rollout(250, break_when_any_done=False)["players"].flatten(0, 1)
    env.close()
    for name, numbers in zip(NAMES, vectors.unbind(-1), strict=True):
        # The farthest players, such as one's own keeper, are four times 25 metres away.
        assert abs(numbers.mean()) < 4.5, name
        assert numbers.std() < 2.5, name
        assert numbers.abs().max() < 8, name
    assert 0.4 < vectors.square().mean().sqrt() < 1.5
    # Most of those that tell something here are not nearly constant.
    deviations = vectors.std(0)
    assert (deviations[deviations > 0] > 0.1).float().mean() > 0.75


def test_the_vector_is_the_same_in_any_batch_shape():
    seeds = range(6)
    matches = as_batch(list(map(made_up_match, seeds)), list(map(made_up_memory, seeds)))
    vectors = Players()(matches.clone())["players"]
    assert torch.equal(Players()(matches.reshape(2, 3))["players"], vectors.view(2, 3, -1))
    assert torch.equal(Players()(matches[4])["players"], vectors[4])
    assert Players()(matches[:0])["players"].shape == (0, len(NAMES))


def single_match() -> TransformedEnv:
    env = GymWrapper(FootballEnv("academy_empty_goal_close"), categorical_action_encoding=True)
    return TransformedEnv(env, Compose(ActionMemory(), Players()))


@pytest.mark.parametrize("num_envs", [None, 3])
def test_specs_describe_what_comes_out(num_envs):
    scenario = "academy_empty_goal_close"
    env = (
        make_env(scenario, num_envs=num_envs, observation="players") if num_envs else single_match()
    )
    check_env_specs(env)
    spec = env.observation_spec["players"]
    assert spec.shape == (*env.batch_size, len(NAMES))
    assert spec.is_in(env.reset()["players"])
    env.close()


def test_matches_that_are_reset_alone_forget_alone():
    env = make_env("academy_3_vs_1_with_keeper", num_envs=3, observation="players", seed=0)
    torch.manual_seed(1)
    data = env.rollout(150, break_when_any_done=False)
    env.close()
    done = data["next", "done"].squeeze(-1)
    assert done.any()
    assert not done.all(0).any()
    memory, last = data["action_memory"], data["action"]
    for match, step in (~done[:, :-1]).nonzero().tolist():
        assert memory[match, step + 1, 0] == last[match, step]
    for match, step in done[:, :-1].nonzero().tolist():
        assert memory[match, step + 1].tolist() == [-1, -1, 100]


def test_stored_observations_are_told_under_next_too():
    env = make_env(
        "academy_empty_goal",
        num_envs=2,
        observation="players",
        keep_keys=OBSERVATION_SPACE,
        seed=0,
    )
    data = env.rollout(5)
    env.close()
    recomputed = Players()(data.exclude("players", ("next", "players")))
    assert torch.equal(recomputed["players"], data["players"])
    assert torch.equal(recomputed["next", "players"], data["next", "players"])


def test_wrong_input_is_named_with_its_remedy():
    matches = as_batch([made_up_match(1)], [made_up_memory(1)])
    with pytest.raises(KeyError, match=r"Players: 'action_memory' is missing.*in_keys"):
        Players()(matches.exclude("action_memory"))
    with pytest.raises(ValueError, match="in_keys must name 21 keys"):
        Players(in_keys=["ball"])
    with pytest.raises(ValueError, match="in_keys must name 1 keys"):
        ActionMemory(in_keys=["action", "ball"])
    env = make_env("academy_empty_goal", num_envs=2, observation="players", seed=0)
    state = env.rand_action(env.reset().exclude("action_memory"))
    with pytest.raises(KeyError, match=r"ActionMemory found no 'action_memory'.*env.reset\(\)"):
        env.step(state)
    env.close()


@pytest.mark.parametrize("module", [fbrl.transforms.players, fbrl.transforms.action_memory])
def test_documented_examples_run(module):
    outcome = doctest.testmod(module)
    assert outcome.attempted > 0
    assert outcome.failed == 0


def test_batched_environments_hand_the_memory_on():
    env = SerialEnv(2, single_match)
    check_env_specs(env)
    torch.manual_seed(0)
    data = env.rollout(60, break_when_any_done=False)
    env.close()
    done = data["next", "done"].squeeze(-1)
    last = torch.where(done, -1, data["action"])[:, :-1]
    assert torch.equal(data["action_memory"][:, 1:, 0], last)
    told = data["players"][..., [NAMES.index(f"last_{name}") for name in ACTION_NAMES]]
    assert torch.equal(told.sum(-1), (data["action_memory"][..., 0] >= 0).float())


def test_a_compose_in_a_compose_remembers_the_same():
    nested = make_env(
        "academy_empty_goal",
        num_envs=2,
        observation=Compose(Compose(ActionMemory(), Players()), EngineActionMask()),
        seed=0,
    )
    flat = make_env("academy_empty_goal", num_envs=2, observation="players", seed=0)
    assert nested.state_spec["action_memory"] == flat.state_spec["action_memory"]
    actions = [torch.tensor([12, 5]), torch.tensor([5, 9])]
    for env in (nested, flat):
        state = env.reset()
        for action in actions:
            state = env.step_mdp(env.step(state.set("action", action)))
        assert state["action_memory"].tolist() == [[5, 12, 1], [9, 9, 0]]
