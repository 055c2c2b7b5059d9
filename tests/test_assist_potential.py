"""AssistDensityPotential: its payments telescope, so that no policy gains on another by them."""

from __future__ import annotations

import doctest
import importlib
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from reward_oracle import has_ball
from scripted_matches import (
    INTEGERS,
    ScriptedMatches,
    episodes,
    random_scoring,
    random_state,
    stored_trajectory,
)
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import (
    Compose,
    GymWrapper,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs
from torchrl.modules import RandomPolicy
from torchrl.objectives.value import GAE

from fbrl.density import AssistDensity, PositionDensity
from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.transforms import AssistDensityPotential, AssistDensityReward, ScoringReward

GAMMA = 0.993
SHIPPED = AssistDensity.default()
HIGHEST = 0.155
"""Of the potential, with the shipped densities."""


def potential(**options: Any) -> AssistDensityPotential:
    return AssistDensityPotential(**{"gamma": GAMMA, **options})


def relabelled(played: list[Any], reward: ScoringReward | None = None) -> TensorDictBase:
    """Episodes that all end by a rule."""
    data = stored_trajectory(played)
    data["next", "terminated"] = data["next", "done"].clone()
    return (reward or potential())(data)


def phi(position: torch.Tensor) -> torch.Tensor:
    """The potential at one position after the other, in double precision."""
    x_y = position.double()
    return 100 * SHIPPED.start(x_y) + SHIPPED.end(x_y)


def expected_potentials(first: dict[str, Any], steps: list[Any]) -> list[float]:
    """After the reset and after each step of an episode that a rule ends, state by state."""
    values, held = [], 0.0
    for state in [first, *(state for state, _ in steps)]:
        if has_ball(state):
            held = float(phi(torch.from_numpy(state["ball"][:2])))
        elif state["ball_owned_team"] == 1 or state["game_mode"] != 0:
            held = 0.0
        values.append(held)
    return [*values[:-1], 0.0]


def rows_of(data: TensorDictBase) -> list[TensorDictBase]:
    return list(data.reshape(-1, data.shape[-1]).unbind(0))


def episodes_of(data: TensorDictBase) -> list[TensorDictBase]:
    """The episodes that ended, each along time alone; every row must begin with one."""
    found = []
    for row in rows_of(data):
        start = 0
        for end in (row["next", "done"].flatten().nonzero().flatten() + 1).tolist():
            found.append(row[start:end])
            start = end
    return found


def discounted(episode: TensorDictBase, key: str = "reward_potential") -> float:
    """The discounted sum over an episode, of the stored single-precision values."""
    paid = episode["next", key].flatten().double()
    return float((paid * discounts(len(paid))).sum())


def discounts(steps: int) -> torch.Tensor:
    return GAMMA ** torch.arange(steps, dtype=torch.float64)


def rounding(steps: int) -> float:
    """What rounding to single precision, of two potentials and their difference, can add up to."""
    return 3 * steps * 2**-24 * HIGHEST


def assert_telescopes(data: TensorDictBase, transform: AssistDensityPotential) -> None:
    ended = episodes_of(data)
    assert ended
    for episode in ended:
        steps = len(episode)
        first = float(transform.potential(episode["last_ball_position"][0].double()))
        last = float(transform.potential(episode["next", "last_ball_position"][-1].double()))
        assert not episode["next", "terminated"][-1] or last == 0
        assert discounted(episode) == pytest.approx(
            GAMMA**steps * last - first, abs=rounding(steps)
        )


def test_the_docstrings_examples_run():
    result = doctest.testmod(importlib.import_module("fbrl.transforms.assist_potential"))
    assert result.attempted > 0
    assert result.failed == 0


def test_the_highest_potential_is_as_documented():
    x, y = torch.linspace(-1, 1, 1001), torch.linspace(-0.42, 0.42, 421)
    highest = float(potential().potential(torch.cartesian_prod(x, y)).max())
    assert 0.99 * HIGHEST < highest <= HIGHEST


@given(played=st.lists(episodes(), min_size=1, max_size=4))
@settings(deadline=None, max_examples=50)
def test_any_match_is_paid_step_by_step_and_telescopes(played):
    data = relabelled(played)
    assert_telescopes(data, potential())
    for episode, (first, steps) in zip(episodes_of(data), played, strict=True):
        values = np.array(expected_potentials(first, steps))
        np.testing.assert_allclose(
            episode["next", "reward_potential"].flatten(),
            GAMMA * values[1:] - values[:-1],
            atol=1e-6,
        )
        scoring = torch.tensor([reward for _, reward in steps])
        assert torch.equal(episode["next", "reward_scoring"].flatten(), scoring)
        torch.testing.assert_close(
            episode["next", "reward"],
            episode["next", "reward_scoring"] + episode["next", "reward_potential"],
        )


def test_in_double_precision_the_sums_are_exact_to_the_rounding_of_the_payments():
    random = np.random.default_rng(0)
    grids = [density.grid.double() for density in (SHIPPED.start, SHIPPED.end)]
    density = AssistDensity(PositionDensity(grids[0], 0.001), PositionDensity(grids[1], 0.1))
    states = [random_state(random) for _ in range(401)]
    data = stored_trajectory([(states[0], [(state, 0.0) for state in states[1:]])])
    data["next", "terminated"] = data["next", "done"].clone()
    for part in (data, data["next"]):
        part["ball"] = part["ball"].double()
    transform = potential(density=density)
    assert_telescopes(transform(data), transform)
    before, after = data["last_ball_position"], data["next", "last_ball_position"]
    exact = GAMMA * transform.potential(after) - transform.potential(before)
    assert exact.dtype == torch.float64
    total = float((exact * discounts(400)).sum())
    assert total == pytest.approx(-float(transform.potential(before[0])), abs=1e-13)


A, B = 3, 7


def moment(x: float, carrier: int | None, active: int, game_mode: int = 0, team: int = 0) -> Any:
    return {
        "ball": np.array([x, 0.0, 0.0], np.float32),
        "ball_owned_team": -1 if carrier is None else team,
        "ball_owned_player": -1 if carrier is None else carrier,
        "active": active,
        "game_mode": game_mode,
    }


def potentials(*states: dict[str, Any], terminated: bool = False) -> list[float]:
    """The potential after each of the states; the first is the reset's."""
    data = stored_trajectory([(states[0], [(state, 0.0) for state in states[1:]])])
    data["next", "terminated"] = data["next", "done"] & terminated
    data = potential()(data)
    positions = [data["last_ball_position"][:1], data["next", "last_ball_position"]]
    return potential().potential(torch.cat(positions)).tolist()


class TestPotential:
    """Hand-made plays: what is the potential worth when?"""

    A_NEAR, B_NEARER = moment(0.5, A, A), moment(0.8, B, B)
    NEAR, NEARER = float(phi(torch.tensor([0.5, 0.0]))), float(phi(torch.tensor([0.8, 0.0])))

    def test_is_held_while_the_ball_is_in_flight(self):
        play = [self.A_NEAR, moment(0.6, None, B), moment(0.7, None, B), self.B_NEARER]
        assert potentials(*play) == pytest.approx([self.NEAR] * 3 + [self.NEARER])

    def test_is_held_while_a_team_mate_who_is_not_controlled_has_the_ball(self):
        play = [self.A_NEAR, moment(0.6, 5, B), self.B_NEARER]
        assert potentials(*play) == pytest.approx([self.NEAR, self.NEAR, self.NEARER])

    def test_is_lost_with_the_ball_and_does_not_come_back_in_flight(self):
        play = [self.A_NEAR, moment(0.6, A, A, team=1), moment(0.7, None, B), self.B_NEARER]
        assert potentials(*play) == pytest.approx([self.NEAR, 0, 0, self.NEARER])

    def test_is_lost_in_a_dead_ball_that_the_controlled_player_does_not_take(self):
        play = [self.A_NEAR, moment(1.0, None, A, 4), moment(1.0, 5, A, 4), self.B_NEARER]
        assert potentials(*play) == pytest.approx([self.NEAR, 0, 0, self.NEARER])

    def test_counts_in_a_dead_ball_that_the_controlled_player_takes(self):
        assert potentials(self.A_NEAR, moment(0.8, B, B, 3)) == pytest.approx(
            [self.NEAR, self.NEARER]
        )

    def test_is_0_until_the_controlled_player_has_the_ball(self):
        assert potentials(moment(0.8, None, A), moment(0.8, None, A)) == [0, 0]

    def test_is_0_at_the_end_that_a_rule_makes_whoever_has_the_ball(self):
        assert potentials(self.A_NEAR, self.B_NEARER, terminated=True) == pytest.approx(
            [self.NEAR, 0]
        )

    def test_is_kept_at_a_time_limit(self):
        assert potentials(self.A_NEAR, self.B_NEARER) == pytest.approx([self.NEAR, self.NEARER])


def test_passing_to_and_fro_and_waiting_gain_nothing():
    away, near = moment(0.3, A, A), moment(0.86, B, B)
    start = moment(0.0, A, A)
    plays = [[away, near] * 20 + [away], [near] * 41, [away] * 41, [moment(0, A, A, team=1)] * 41]
    sums = []
    for play in plays:
        data = relabelled([(start, [(state, 0.0) for state in play])])
        sums.append(discounted(data))
        farmed = AssistDensityReward()(data.clone())["next", "reward_end_density"].sum()
        assert farmed > 1 or play is not plays[0], "the thesis's reward pays for it"
    assert sums == pytest.approx([sums[0]] * 4, abs=2 * rounding(41))


def test_the_weights_scale_the_potential():
    position = torch.tensor([[0.6, 0.1], [0.86, 0.0], [1.1, 0.0]])
    start, end = SHIPPED.start(position), SHIPPED.end(position)
    reward = potential(weight=2.0, start_weight=10.0)
    torch.testing.assert_close(reward.potential(position), 2 * (10 * start + end))
    data = relabelled([(moment(0.5, A, A), [(moment(0.8, A, A), 1.0)])], potential(weight=0.0))
    assert data["next", "reward"].item() == 1.0


def advantages(data: TensorDictBase, reward: str, values: torch.Tensor, next_values: torch.Tensor):
    batch = data.select("next").clone()
    batch["next", "reward"] = batch["next", reward].double()
    batch["state_value"], batch["next", "state_value"] = values, next_values
    GAE(gamma=GAMMA, lmbda=0.95, value_network=None)(batch, time_dim=data.ndim - 1)
    return batch["advantage"]


def test_advantages_are_those_of_goals_if_the_critic_knows_the_potential():
    """Also past time limits, where the value goes on and so must the potential."""
    random = np.random.default_rng(3)
    played = [
        (random_state(random), [(random_state(random), random_scoring(random)) for _ in range(9)])
        for _ in range(12)
    ]
    data = stored_trajectory(played)
    by_a_rule = torch.arange(len(data)).unsqueeze(-1) // 9 % 2 == 0
    data["next", "terminated"] = data["next", "done"] & by_a_rule
    transform = potential()
    data = transform(data)
    before = transform.potential(data["last_ball_position"]).double().unsqueeze(-1)
    after = transform.potential(data["next", "last_ball_position"]).double().unsqueeze(-1)
    at_limits = (data["next", "done"] & ~data["next", "terminated"]).squeeze(-1)
    assert after[at_limits].any(), "somebody has the ball when the time is over"
    values, next_values = torch.from_numpy(random.normal(size=(2, len(data), 1)))
    torch.testing.assert_close(
        advantages(data, "reward", values - before, next_values - after),
        advantages(data, "reward_scoring", values, next_values),
        atol=1e-6,
        rtol=0,
    )


def single_matches() -> TransformedEnv:
    return TransformedEnv(ScriptedMatches((5,), batched=False, seed=1), potential())


def vectorised_matches() -> TransformedEnv:
    return TransformedEnv(ScriptedMatches(), potential())


def serial_of_transformed() -> SerialEnv:
    return SerialEnv(2, [single_matches] * 2)


def transformed_serial() -> TransformedEnv:
    makers = [lambda s=seed: ScriptedMatches((3 + s,), batched=False, seed=s) for seed in (0, 2)]
    return TransformedEnv(SerialEnv(2, makers), potential())


ARRANGEMENTS = [single_matches, vectorised_matches, serial_of_transformed, transformed_serial]

WRITTEN = (
    "last_ball_position",
    *(("next", key) for key in ("last_ball_position", "reward_potential", "reward_scoring")),
)


def as_recorded_without(data: TensorDictBase) -> TensorDictBase:
    """What the base environment alone would have stored."""
    stored = data.clone()
    stored["next", "reward"] = stored["next", "reward_scoring"].clone()
    return stored.exclude(*WRITTEN)


class TestInsideTorchRL:
    @pytest.mark.parametrize("make", ARRANGEMENTS)
    def test_specs_and_rollouts_through_partial_resets(self, make):
        env = make()
        check_env_specs(env, break_when_any_done="both")
        data = env.rollout(80, break_when_any_done=False)
        assert data["next", "reward_potential"].any()
        assert len(episodes_of(data)) > 10
        assert_telescopes(data, potential())
        stored = as_recorded_without(data)
        once = potential()(stored)
        assert (once == data).all()
        assert (potential()(once.clone()) == data).all()

    @pytest.mark.slow
    def test_parallel(self):
        env = ParallelEnv(2, single_matches)
        try:
            check_env_specs(env)
            data = env.rollout(60, break_when_any_done=False)
        finally:
            env.close(raise_if_closed=False)
        assert_telescopes(data, potential())

    def test_the_memory_goes_on_from_batch_to_batch(self):
        env = vectorised_matches()
        collector = Collector(
            env,
            RandomPolicy(env.action_spec),
            frames_per_batch=12,  # four steps of each match, shorter than most episodes
            total_frames=240,
            auto_register_policy_transforms=False,
        )
        data = torch.cat([batch.clone() for batch in collector], dim=1)
        collector.shutdown()
        assert data.shape == (3, 80)
        assert_telescopes(data, potential())

    def test_the_parts_are_rewards_and_sum_up_per_episode(self):
        sums = RewardSum(in_keys=["reward", "reward_scoring", "reward_potential"])
        env = TransformedEnv(ScriptedMatches(), Compose(potential(), sums))
        check_env_specs(env)
        for episode in episodes_of(env.rollout(40, break_when_any_done=False)):
            torch.testing.assert_close(
                episode["next", "episode_reward_potential"],
                episode["next", "reward_potential"].cumsum(0),
            )

    def test_a_replay_buffer_of_shuffled_transitions_takes_other_densities(self):
        torch.manual_seed(0)
        collected = vectorised_matches().rollout(60, break_when_any_done=False).reshape(-1)
        other = potential(density="mirrored", weight=3.0)
        buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(len(collected)), transform=other, batch_size=64
        )
        buffer.extend(collected)
        sample = buffer.sample()
        expected = other(as_recorded_without(collected[: 3 * 60].reshape(3, 60))).reshape(-1)
        paid = expected["next", "reward_potential"][sample["index"]]
        assert paid.any()
        assert torch.equal(sample["next", "reward_potential"], paid)

    def test_one_reward_after_the_other_on_the_same_data(self):
        data = vectorised_matches().rollout(60, break_when_any_done=False)
        kept = as_recorded_without(data)
        through = potential()(AssistDensityReward()(kept.clone()))
        assert torch.equal(through["next", "reward"], data["next", "reward"])


class TestErrors:
    @pytest.mark.parametrize(
        ("options", "error", "message"),
        [
            ({"gamma": 1.1}, ValueError, "gamma is 1.1; expected a finite number from 0 to 1"),
            ({"gamma": -0.1}, ValueError, "gamma is -0.1"),
            ({"gamma": "0.9"}, TypeError, "gamma is '0.9'; expected a number"),
            ({"weight": -1}, ValueError, "weight is -1; expected a finite number of at least 0"),
            ({"start_weight": float("nan")}, ValueError, "start_weight is nan"),
            ({"density": 3}, TypeError, "density is a int"),
        ],
    )
    def test_a_wrong_option_is_named_with_what_is_allowed(self, options, error, message):
        with pytest.raises(error, match=message):
            potential(**options)

    def test_the_discount_has_to_be_given(self):
        with pytest.raises(TypeError, match="'gamma'"):
            AssistDensityPotential()

    def test_data_that_does_not_say_how_it_ended_is_refused(self):
        data = stored_trajectory([(moment(0.5, A, A), [(moment(0.8, A, A), 0.0)])])
        with pytest.raises(KeyError, match=r"no 'terminated' in 'next'.*keys={'terminated'"):
            potential()(data)
        taken = potential(keys={"terminated": "done"})(data)
        assert (taken["next", "last_ball_position"] == -2).all()


def attacker(seed: int) -> TensorDictModule:
    """Runs to the right and passes often, so that passes are received."""
    random = np.random.default_rng(seed)

    def policy(ball: torch.Tensor) -> torch.Tensor:
        actions = random.choice([5, 5, 4, 6, 9, 11, 11, 12, 0], ball.shape[:-1])
        return torch.nn.functional.one_hot(torch.as_tensor(actions), 19)

    return TensorDictModule(policy, in_keys=["ball"], out_keys=["action"])


class TestRealMatches:
    def test_vectorised(self):
        base = GymWrapper(FootballVectorEnv("academy_3_vs_1_with_keeper", num_envs=2))
        env = TransformedEnv(base, potential())
        env.set_seed(1)
        check_env_specs(env)
        data = env.rollout(400, attacker(0), break_when_any_done=False)
        env.close()
        assert_telescopes(data, potential())
        paid = potential()(as_recorded_without(data))
        assert torch.equal(paid["next", "reward_potential"], data["next", "reward_potential"])
        in_flight = data["next", "ball_owned_team"] == -1
        kept = data["last_ball_position"] == data["next", "last_ball_position"]
        assert (kept.all(-1) & in_flight.reshape(kept.shape[:-1])).any()

    def test_the_ball_at_the_feet_when_the_time_is_over(self):
        base = GymWrapper(FootballEnv("academy_empty_goal_close", [*INTEGERS, "ball"]))
        env = TransformedEnv(base, Compose(potential(), StepCounter(max_steps=12)))
        env.set_seed(3)
        run_right = TensorDictModule(always_right, in_keys=["ball"], out_keys=["action"])
        data = env.rollout(100, run_right)
        env.close()
        assert len(data) == 12
        assert data["next", "truncated"][-1]
        assert not data["next", "terminated"][-1]
        last = potential().potential(data["next", "last_ball_position"][-1])
        assert last > 0.01
        assert_telescopes(data[None], potential())


def always_right(ball: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.one_hot(torch.full(ball.shape[:-1], 5), 19)
