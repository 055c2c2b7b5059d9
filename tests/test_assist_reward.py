"""AssistDensityReward against the oracle, in every way that TorchRL runs a transform."""

from __future__ import annotations

import doctest
import importlib
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from reward_oracle import carriers, exact_density, walk
from scipy.interpolate import RegularGridInterpolator
from scripted_matches import (
    INTEGERS,
    ScriptedMatches,
    episodes,
    random_state,
    stored_trajectory,
)
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, SliceSampler, TensorDictReplayBuffer
from torchrl.envs import (
    Compose,
    GymWrapper,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs
from torchrl.modules import RandomPolicy
from torchrl.objectives.value import GAE

from fbrl.density import AssistDensity, PositionDensity
from fbrl.density.fit import PEAK_END, PEAK_START
from fbrl.density.kde import grid_positions, kernel_covariance, kernel_sum
from fbrl.density.passes import starts_and_ends
from fbrl.density.tables import read_passes_csv
from fbrl.envs import FootballEnv, FootballVectorEnv
from fbrl.transforms import AssistDensityReward, CheckpointReward, ScoringReward

PARTS = ("reward_scoring", "reward_start_density", "reward_end_density")
TRANSITIONS = ("possession", "consecutive")
MEMORY = {"possession": "last_ball_carrier", "consecutive": "last_active"}
ASSISTS = Path(__file__).parents[2] / "shared" / "data" / "open_play_assists.csv"


def interpolated(density: PositionDensity):
    """A density's surface by scipy's interpolation instead of ours."""
    grid = density.grid.double().numpy()
    axes = (np.linspace(-1, 1, grid.shape[0]), np.linspace(-0.42, 0.42, grid.shape[1]))
    surface = RegularGridInterpolator(axes, grid, bounds_error=False, fill_value=0.0)

    def value(x: float, y: float) -> float:
        if np.isnan([x, y]).any() or abs(x) > 1 or abs(y) > 0.42 + 1e-7:
            return 0.0
        return density.peak * float(surface([x, np.clip(y, -0.42, 0.42)])[0])

    return value


SHIPPED = AssistDensity.default()
F_START, F_END = interpolated(SHIPPED.start), interpolated(SHIPPED.end)


def states_of(steps: TensorDictBase) -> list[dict[str, Any]]:
    entries = {key: steps[key].reshape(len(steps), -1).numpy() for key in ("ball", *INTEGERS)}
    return [
        {"ball": entries["ball"][t], **{key: int(entries[key][t, 0]) for key in INTEGERS}}
        for t in range(len(steps))
    ]


def rows_of(data: TensorDictBase) -> list[TensorDictBase]:
    """The trajectories of the matches, each along time alone."""
    return list(data.reshape(-1, data.shape[-1]).unbind(0))


def episodes_of(row: TensorDictBase) -> list[TensorDictBase]:
    ends = (row["next", "done"].flatten().nonzero().flatten() + 1).tolist()
    bounds = [0, *ends, *([len(row)] if not ends or ends[-1] < len(row) else [])]
    return [row[a:b] for a, b in itertools.pairwise(bounds)]


def assert_paid_as_the_oracle_says(
    data: TensorDictBase,
    transition: str = "possession",
    weight: float = 1.0,
    f_start: Any = F_START,
    f_end: Any = F_END,
    tolerance: float = 2e-6,
) -> None:
    """Every row must start with the start of an episode.

    ``tolerance`` is of a density that is paid once: a weight multiplies its float32 error too.
    """
    tolerance *= max(1.0, weight)
    for row in rows_of(data):
        for episode in episodes_of(row):
            first, states = states_of(episode[:1])[0], states_of(episode["next"])
            scoring = episode["next", "reward_scoring"].flatten().tolist()
            steps = list(zip(states, scoring, strict=True))
            paid = walk(first, steps, f_start, f_end, transition=transition, weight=weight)
            expected = {
                "reward_scoring": [step.scoring for step in paid],
                "reward_start_density": [step.start for step in paid],
                "reward_end_density": [step.end for step in paid],
                "reward": [step.reward for step in paid],
            }
            for key, values in expected.items():
                got = episode["next", key]
                assert got.shape == (len(paid), 1)
                assert got.dtype == torch.float32
                np.testing.assert_allclose(got.flatten(), values, atol=tolerance, err_msg=key)
            if transition == "possession":
                memory = carriers(first, states)
                assert episode["last_ball_carrier"].flatten().tolist() == memory[:-1]
                assert episode["next", "last_ball_carrier"].flatten().tolist() == memory[1:]


def assert_not_all_zero(data: TensorDictBase) -> None:
    for key in PARTS:
        assert data["next", key].any(), f"{key} was never paid: the test would not see it wrong"


@pytest.mark.parametrize("module", ["assist_reward", "scoring_reward"])
def test_the_docstrings_examples_run(module):
    result = doctest.testmod(importlib.import_module(f"fbrl.transforms.{module}"))
    assert result.attempted > 0
    assert result.failed == 0


class TestAgainstTheOracle:
    @given(
        played=st.lists(episodes(), min_size=1, max_size=4),
        transition=st.sampled_from(TRANSITIONS),
        weight=st.sampled_from([1.0, 0.0, 2.5]),
    )
    @settings(deadline=None, max_examples=150)
    def test_any_match(self, played, transition, weight):
        data = stored_trajectory(played)
        AssistDensityReward(transition=transition, weight=weight)(data)
        assert_paid_as_the_oracle_says(data, transition, weight)

    @given(played=st.lists(episodes(), min_size=1, max_size=2))
    @settings(deadline=None, max_examples=25)
    def test_each_density_has_a_weight_of_its_own(self, played):
        data = stored_trajectory(played)
        AssistDensityReward(weight=2.0, start_weight=0.0, end_weight=3.0)(data)
        assert_paid_as_the_oracle_says(
            data, f_start=lambda x, y: 0.0, f_end=lambda x, y: 6.0 * F_END(x, y), tolerance=1e-5
        )

    def test_the_exact_kernel_sum_within_half_a_percent_of_the_peaks(self):
        random = np.random.default_rng(0)
        clouds = [
            np.clip(random.normal(m, 0.15, (40, 2)), [-1, -0.42], [1, 0.42])
            for m in ([0.4, 0.1], [0.7, 0.0])
        ]
        densities, exact = [], []
        for points, peak in zip(clouds, (PEAK_START, PEAK_END), strict=True):
            nodes = grid_positions(121, 51)
            grid = kernel_sum(points, nodes, kernel_covariance(points, "thesis"))
            densities.append(PositionDensity(torch.from_numpy(grid).float(), peak))
            exact.append(exact_density(points, peak, nodes.reshape(-1, 2)[[grid.argmax()]]))
        played = [
            (random_state(random), [(random_state(random), 0.0) for _ in range(30)])
            for _ in range(20)
        ]
        data = AssistDensityReward(AssistDensity(*densities))(stored_trajectory(played))
        assert data["next", "reward_end_density"].any()
        assert_paid_as_the_oracle_says(
            data, f_start=exact[0], f_end=exact[1], tolerance=0.006 * PEAK_END
        )

    @pytest.mark.skipif(not ASSISTS.exists(), reason="the StatsBomb table is not here")
    def test_the_shipped_densities_are_the_exact_sums_over_the_474_assists(self):
        exact = []
        positions = starts_and_ends(read_passes_csv(ASSISTS).rows)
        for points, density in zip(positions, (SHIPPED.start, SHIPPED.end), strict=True):
            nodes = grid_positions(*density.grid.shape)
            best = nodes.reshape(-1, 2)[int(density.grid.argmax())]
            exact.append(exact_density(points, density.peak, best[None]))
        random = np.random.default_rng(1)
        played = [
            (random_state(random), [(random_state(random), 0.0) for _ in range(30)])
            for _ in range(20)
        ]
        data = AssistDensityReward()(stored_trajectory(played))
        assert_paid_as_the_oracle_says(
            data, f_start=exact[0], f_end=exact[1], tolerance=0.005 * PEAK_END
        )
        # The tolerance above would hide the start density.
        start = data["next", "reward_start_density"]
        owned = start > 0
        expected = [
            exact[0](*ball[:2].tolist()) for ball in data["next", "ball"][owned.squeeze(-1)]
        ]
        np.testing.assert_allclose(start[owned], expected, atol=0.005 * PEAK_START)


A, B, NOT_CONTROLLED = 3, 7, 5


def moment(carrier: int | None, active: int, game_mode: int = 0, team: int = 0) -> dict[str, Any]:
    """A state with the ball at the end density's peak; nobody has it for ``carrier=None``."""
    return {
        "ball": np.array([0.86, 0.0, 0.0], np.float32),
        "ball_owned_team": -1 if carrier is None else team,
        "ball_owned_player": -1 if carrier is None else carrier,
        "active": active,
        "game_mode": game_mode,
    }


A_HAS_IT, B_HAS_IT = moment(A, A), moment(B, B)
IN_FLIGHT = moment(None, B)
OPPONENT = moment(A, A, team=1)
DEAD_BALL = moment(A, A, game_mode=3)


class TestTransition:
    """Hand-made plays: at which steps is a received pass paid?"""

    @pytest.mark.parametrize(
        ("play", "possession", "consecutive"),
        [
            ([A_HAS_IT, IN_FLIGHT, IN_FLIGHT, B_HAS_IT, B_HAS_IT], {3}, set()),
            ([A_HAS_IT, B_HAS_IT, A_HAS_IT], {1, 2}, {1, 2}),
            ([A_HAS_IT, IN_FLIGHT, A_HAS_IT], set(), {2}),
            ([A_HAS_IT, moment(NOT_CONTROLLED, B), B_HAS_IT], {2}, set()),
            ([A_HAS_IT, OPPONENT, B_HAS_IT], set(), {2}),
            ([A_HAS_IT, OPPONENT, IN_FLIGHT, B_HAS_IT], set(), set()),
            ([A_HAS_IT, DEAD_BALL, B_HAS_IT], set(), {2}),
            ([A_HAS_IT, IN_FLIGHT, moment(B, B, game_mode=4), B_HAS_IT], set(), set()),
            ([IN_FLIGHT, B_HAS_IT, A_HAS_IT], {2}, {2}),
            ([OPPONENT, B_HAS_IT], set(), {1}),
            ([moment(0, 0), IN_FLIGHT, B_HAS_IT], {2}, set()),
        ],
    )
    def test_pays_a_received_pass(self, play, possession, consecutive):
        played = [(play[0], [(state, 0.0) for state in play[1:]])]
        for transition, expected in (("possession", possession), ("consecutive", consecutive)):
            data = AssistDensityReward(transition=transition)(stored_trajectory(played))
            paid = data["next", "reward_end_density"].flatten().nonzero().flatten() + 1
            assert set(paid.tolist()) == expected

    def test_the_next_episode_remembers_nothing(self):
        played = [(A_HAS_IT, [(A_HAS_IT, 0.0)]), (IN_FLIGHT, [(B_HAS_IT, 0.0)])]
        data = AssistDensityReward()(stored_trajectory(played))
        assert not data["next", "reward_end_density"].any()

    def test_the_ball_at_reset_is_remembered(self):
        played = [(IN_FLIGHT, [(IN_FLIGHT, 0.0)]), (A_HAS_IT, [(B_HAS_IT, 0.0)])]
        data = AssistDensityReward()(stored_trajectory(played))
        assert data["next", "reward_end_density"].flatten().bool().tolist() == [False, True]

    def test_having_the_ball_is_paid_in_a_dead_ball_too(self):
        data = AssistDensityReward()(stored_trajectory([(A_HAS_IT, [(DEAD_BALL, 0.0)])]))
        assert data["next", "reward_start_density"].item() > 0


def scripted(transition: str, *, batched: bool = True, seed: int = 0) -> TransformedEnv:
    base = ScriptedMatches() if batched else ScriptedMatches((5,), batched=False, seed=seed)
    return TransformedEnv(base, AssistDensityReward(transition=transition))


def scripted_single() -> TransformedEnv:
    return scripted("possession", batched=False, seed=1)


def scripted_base() -> ScriptedMatches:
    return ScriptedMatches((4,), batched=False, seed=2)


def single_matches(transition: str) -> TransformedEnv:
    return scripted(transition, batched=False)


def vectorised_matches(transition: str) -> TransformedEnv:
    return scripted(transition)


def serial_of_transformed(transition: str) -> SerialEnv:
    makers = [lambda s=seed: scripted(transition, batched=False, seed=s) for seed in range(2)]
    return SerialEnv(2, makers)


def transformed_serial(transition: str) -> TransformedEnv:
    makers = [lambda s=seed: ScriptedMatches((3 + s,), batched=False, seed=s) for seed in (0, 2)]
    return TransformedEnv(SerialEnv(2, makers), AssistDensityReward(transition=transition))


ARRANGEMENTS = [single_matches, vectorised_matches, serial_of_transformed, transformed_serial]


class TestInsideTorchRL:
    @pytest.mark.parametrize("transition", TRANSITIONS)
    @pytest.mark.parametrize("make", ARRANGEMENTS)
    def test_specs_and_rollouts_through_partial_resets(self, make, transition):
        env = make(transition)
        check_env_specs(env, break_when_any_done="both")
        data = env.rollout(120, break_when_any_done=False)
        assert data["next", "done"].sum() > 10
        assert_not_all_zero(data)
        assert_paid_as_the_oracle_says(data, transition)

    @pytest.mark.slow
    @pytest.mark.parametrize("inside", [True, False])
    def test_parallel(self, inside):
        env = (
            ParallelEnv(2, scripted_single)
            if inside
            else TransformedEnv(ParallelEnv(2, scripted_base), AssistDensityReward())
        )
        try:
            check_env_specs(env)
            data = env.rollout(60, break_when_any_done=False)
        finally:
            env.close(raise_if_closed=False)
        assert_not_all_zero(data)
        assert_paid_as_the_oracle_says(data)

    def test_all_matches_to_their_end(self):
        env = scripted("possession")
        data = env.rollout(20, break_when_any_done=False, break_when_all_done=True)
        for row, length in zip(rows_of(data), env.base_env.lengths, strict=True):
            assert_paid_as_the_oracle_says(row[None, :length])

    @pytest.mark.parametrize("transition", TRANSITIONS)
    def test_collector(self, transition):
        env = scripted(transition)
        collector = Collector(
            env,
            RandomPolicy(env.action_spec),
            frames_per_batch=30,
            total_frames=240,
            auto_register_policy_transforms=False,
        )
        data = torch.cat([batch.clone() for batch in collector], dim=1)
        collector.shutdown()
        assert data.shape == (3, 80)
        assert_not_all_zero(data)
        assert_paid_as_the_oracle_says(data, transition)

    def test_the_parts_are_rewards_and_sum_up_per_episode(self):
        sums = RewardSum(in_keys=["reward", *PARTS])
        env = TransformedEnv(ScriptedMatches(), Compose(AssistDensityReward(), sums))
        check_env_specs(env)
        assert set(env.reward_keys) == {"reward", *PARTS}
        data = env.rollout(100, break_when_any_done=False)
        for row in rows_of(data):
            for episode in episodes_of(row):
                for key in ("reward", *PARTS):
                    torch.testing.assert_close(
                        episode["next", f"episode_{key}"], episode["next", key].cumsum(0)
                    )
                together = sum(episode["next", f"episode_{part}"] for part in PARTS)
                torch.testing.assert_close(together, episode["next", "episode_reward"])

    def test_parts_are_not_carried_to_the_next_root(self):
        data = scripted("possession").rollout(5)
        assert not {"reward", *PARTS} & set(data.keys())
        assert "last_ball_carrier" in data.keys()  # noqa: SIM118 (a tensordict is no dict)

    def test_gae_reads_the_whole_reward(self):
        data = scripted("possession").rollout(20, break_when_any_done=False)
        data["state_value"] = data["next", "state_value"] = torch.zeros(3, 20, 1)
        data["next", "terminated"] = data["next", "done"]
        GAE(gamma=0.5, lmbda=0.0, value_network=None)(data)
        torch.testing.assert_close(data["value_target"], data["next", "reward"])

    def test_the_bounds_of_the_reward_are_lifted(self):
        from torchrl.data import Bounded

        base = ScriptedMatches()
        base.reward_spec = Bounded(-1, 1, (3, 1))
        spec = TransformedEnv(base, AssistDensityReward()).full_reward_spec
        assert spec["reward"].is_in(torch.full((3, 1), 1.05))
        assert not spec["reward_scoring"].is_in(torch.full((3, 1), 1.05))

    def test_a_stepped_tensordict_can_be_stepped_again(self):
        # TransformedEnv hands an existing "next" on to the transform: an old reward_scoring in
        # it must not be taken for this step's.
        env = scripted("possession", batched=False)
        start = env.reset()
        start["action"] = env.action_spec.zero()
        once = env.step(start)
        scoring = []
        for _ in range(3):
            once["next", "reward_scoring"] = torch.full((1,), 77.0)
            once = env.step(once)
            scoring.append(once["next", "reward_scoring"].item())
        assert set(scoring) <= {-1.0, 0.0, 1.0}

    def test_a_partial_reset_keeps_the_other_matches_memory(self):
        transform = AssistDensityReward()
        kept = TensorDict(
            {"last_ball_carrier": torch.tensor([4, 5, 6]), "_reset": torch.tensor([[0], [1], [0]])},
            [3],
        )
        kept["_reset"] = kept["_reset"].bool()
        seen = stored_trajectory([(A_HAS_IT, [(A_HAS_IT, 0.0)] * 3)]).exclude("next")
        after = transform._reset(kept, seen.clone())
        assert after["last_ball_carrier"].tolist() == [4, A, 6]
        after = transform._reset(kept.select("last_ball_carrier"), seen.clone())
        assert after["last_ball_carrier"].tolist() == [A, A, A]

    def test_entries_under_other_names(self):
        keys = {name: ("match", name) for name in ("ball", *INTEGERS)}
        written = {
            "reward_end_density": ("shaping", "pass"),
            "last_ball_carrier": ("match", "carrier"),
        }
        data = stored_trajectory([(A_HAS_IT, [(IN_FLIGHT, 0.0), (B_HAS_IT, 1.0)])])
        plain = AssistDensityReward()(data.clone())
        for part in (data, data["next"]):
            for name in ("ball", *INTEGERS):
                part.rename_key_(name, ("match", name))
        renamed = AssistDensityReward(keys=keys | written)(data)
        paid = renamed["next", "shaping", "pass"]
        assert paid.any()
        torch.testing.assert_close(paid, plain["next", "reward_end_density"])
        assert renamed["next", "match", "carrier"].tolist() == [A, B]

    def test_without_a_second_team_and_stops_of_the_game(self):
        absent = ("ball_owned_team", "game_mode")
        play = [A_HAS_IT, IN_FLIGHT | {"ball_owned_team": 0}, B_HAS_IT, A_HAS_IT]
        data = stored_trajectory([(play[0], [(state, 0.0) for state in play[1:]])])
        plain = AssistDensityReward()(data.clone())
        assert plain["next", "reward_end_density"].flatten().bool().tolist() == [0, 1, 1]
        fewer = data.exclude(*absent, *(("next", name) for name in absent))
        transform = AssistDensityReward(keys=dict.fromkeys(absent))
        assert not set(absent) & set(transform.in_keys)
        paid = transform(fewer)
        assert (paid["next", "reward"] == plain["next", "reward"]).all()
        assert (paid["last_ball_carrier"] == plain["last_ball_carrier"]).all()

    def test_with_nothing_but_a_ball(self):
        base = ScriptedMatches()
        for name in INTEGERS:
            del base.observation_spec[name]
        env = TransformedEnv(base, AssistDensityReward(keys=dict.fromkeys(INTEGERS)))
        data = env.rollout(40, break_when_any_done=False)
        start = data["next", "reward_start_density"].squeeze(-1)
        assert start.any()
        torch.testing.assert_close(start, SHIPPED.start(data["next", "ball"][..., :2]))
        assert not data["next", "reward_end_density"].any()

    def test_other_names_inside_an_environment(self):
        from torchrl.envs import RenameTransform

        nested = RenameTransform(
            in_keys=["ball", *INTEGERS],
            out_keys=[("match", "ball"), *(("match", name) for name in INTEGERS)],
            create_copy=True,
        )
        keys = {name: ("match", name) for name in ("ball", *INTEGERS)}
        keys["last_ball_carrier"] = ("match", "carrier")
        keys["reward_scoring"] = "goals"
        env = TransformedEnv(ScriptedMatches(), Compose(nested, AssistDensityReward(keys=keys)))
        check_env_specs(env)
        plain = TransformedEnv(ScriptedMatches(), AssistDensityReward())
        check_env_specs(plain)  # as above, so that the same episodes follow
        data = env.rollout(40, break_when_any_done=False)
        same = plain.rollout(40, break_when_any_done=False)
        torch.testing.assert_close(data["next", "reward"], same["next", "reward"])
        torch.testing.assert_close(data["next", "goals"], same["next", "reward_scoring"])

    def test_compiles_without_a_break(self):
        data = AssistDensityReward()(stored_trajectory([(A_HAS_IT, [(B_HAS_IT, 0.0)] * 4)]))
        transform = AssistDensityReward()
        observation = transform._observe(data["next"], "'next'")
        arguments = (
            {"last_ball_carrier": data["last_ball_carrier"]},
            observation,
            data["next", "reward"].squeeze(-1),
        )
        compiled = torch.compile(transform._advance, backend="eager", fullgraph=True)
        torch.testing.assert_close(compiled(*arguments), transform._advance(*arguments))


STRIPPED = (
    "last_ball_carrier",
    "last_active",
    *(("next", key) for key in (*PARTS, "last_ball_carrier", "last_active")),
)


def as_recorded_without(data: TensorDictBase) -> TensorDictBase:
    """What the base environment alone would have stored."""
    stored = data.clone()
    stored["next", "reward"] = stored["next", "reward_scoring"].clone()
    return stored.exclude(*STRIPPED)


class TestRelabelling:
    @pytest.mark.parametrize("transition", TRANSITIONS)
    @pytest.mark.parametrize("make", ARRANGEMENTS)
    def test_a_stored_rollout_gets_what_the_environment_gave(self, make, transition):
        collected = make(transition).rollout(80, break_when_any_done=False)
        relabelled = AssistDensityReward(transition=transition)(as_recorded_without(collected))
        assert (relabelled == collected).all()

    def test_the_time_dimension_is_found_by_name(self):
        collected = scripted("possession").rollout(60, break_when_any_done=False)
        turned = as_recorded_without(collected).transpose(0, 1).contiguous()
        turned.names = ["time", None]
        relabelled = AssistDensityReward()(turned)
        assert (relabelled.transpose(0, 1) == collected).all()

    def test_twice_is_once(self):
        once = AssistDensityReward()(
            as_recorded_without(scripted("possession").rollout(60, break_when_any_done=False))
        )
        twice = AssistDensityReward()(once.clone())
        assert (once == twice).all()

    def test_another_reward_replaces_the_first(self):
        collected = scripted("possession").rollout(60, break_when_any_done=False)
        changed = AssistDensityReward(weight=3.0)(collected.clone())
        torch.testing.assert_close(
            changed["next", "reward_end_density"], 3 * collected["next", "reward_end_density"]
        )
        assert_paid_as_the_oracle_says(changed, weight=3.0)
        plain = ScoringReward()(changed)
        assert (plain["next", "reward"] == collected["next", "reward_scoring"]).all()

    def test_shuffled_transitions_with_their_memory(self):
        collected = scripted("possession").rollout(60, break_when_any_done=False).reshape(-1)
        order = torch.randperm(len(collected), generator=torch.Generator().manual_seed(0))
        shuffled = collected[order].exclude(*(("next", part) for part in PARTS[1:]))
        assert (AssistDensityReward()(shuffled) == collected[order]).all()

    def test_shuffled_transitions_without_it_are_refused(self):
        collected = scripted("possession").rollout(60, break_when_any_done=False).reshape(-1)
        order = torch.randperm(len(collected), generator=torch.Generator().manual_seed(0))
        with pytest.raises(ValueError, match=r"Without 'last_ball_carrier'.*consecutive steps"):
            AssistDensityReward()(as_recorded_without(collected[order]))

    def test_shuffled_transitions_without_it_do_for_the_literal_reading(self):
        collected = scripted("consecutive").rollout(60, break_when_any_done=False).reshape(-1)
        order = torch.randperm(len(collected), generator=torch.Generator().manual_seed(0))
        relabelled = AssistDensityReward(transition="consecutive")(
            as_recorded_without(collected[order])
        )
        assert (relabelled == collected[order]).all()

    def test_a_single_transition_needs_its_memory(self):
        collected = scripted("possession", batched=False).rollout(5)
        assert (AssistDensityReward()(collected[3].clone()) == collected[3]).all()
        with pytest.raises(KeyError, match="Without 'last_ball_carrier', a single transition"):
            AssistDensityReward()(as_recorded_without(collected)[3])

    @pytest.mark.parametrize("shape", [[0], [2, 0], [0, 3]])
    def test_nothing_is_relabelled_as_nothing(self, shape):
        one = as_recorded_without(scripted("possession", batched=False).rollout(1))[0]
        nothing = one.expand(*shape).clone()
        assert AssistDensityReward()(nothing)["next", "reward_end_density"].shape == (*shape, 1)

    def test_replay_buffer_of_transitions(self):
        # Passes are few, so that an unseeded sample may miss them all.
        torch.manual_seed(0)
        collected = scripted("possession").rollout(60, break_when_any_done=False).reshape(-1)
        buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(len(collected)),
            transform=AssistDensityReward(weight=2.0),
            batch_size=64,
        )
        buffer.extend(collected)
        for _ in range(2):
            sample = buffer.sample()
            expected = AssistDensityReward(weight=2.0)(collected.clone())[sample["index"]]
            assert sample["next", "reward_end_density"].any()
            assert (sample["next", "reward"] == expected["next", "reward"]).all()
        stored = buffer.storage[:]
        assert (stored["next", "reward"] == collected["next", "reward"]).all()

    def test_replay_buffer_of_slices_without_memory(self):
        collected = scripted("possession").rollout(64, break_when_any_done=False)
        stored = as_recorded_without(collected)
        stored["next", "done"][:, -1] = True  # the matches' rows become one
        stored = stored.reshape(-1)
        stored["episode"] = (
            stored["next", "done"].flatten().cumsum(0) - stored["next", "done"].flatten().long()
        )
        buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(len(stored)),
            sampler=SliceSampler(num_slices=4, traj_key="episode", strict_length=False),
            batch_size=16,
        )
        buffer.extend(stored)
        for _ in range(20):
            assert_paid_as_the_oracle_says(AssistDensityReward()(buffer.sample()))
        # The sampler marks the slices' ends only after the buffer's own transforms.
        buffer.append_transform(AssistDensityReward())
        refused = 0
        for seed in range(20):
            torch.manual_seed(seed)
            try:
                sample = buffer.sample()
            except ValueError as error:
                refused += "call this transform on what it returns" in str(error)
            else:  # all slices ended with their episodes
                assert_paid_as_the_oracle_says(sample)
        assert refused > 0

    def test_inside_a_model(self):
        collected = scripted("possession").rollout(20, break_when_any_done=False)
        doubled = TensorDictModule(lambda r: 2 * r, in_keys=[("next", "reward")], out_keys=["x"])
        model = TensorDictSequential(Compose(AssistDensityReward()), doubled)
        torch.testing.assert_close(model(collected)["x"], 2 * collected["next", "reward"])

    @pytest.mark.parametrize("dtype", [torch.int64, torch.int32, torch.int8])
    def test_integers_of_any_width_with_a_trailing_dimension(self, dtype):
        collected = scripted("possession").rollout(40, break_when_any_done=False)
        other = as_recorded_without(collected)
        for part in (other, other["next"]):
            for key in INTEGERS:
                part[key] = part[key].to(dtype).unsqueeze(-1)
        relabelled = AssistDensityReward()(other)
        torch.testing.assert_close(relabelled["next", "reward"], collected["next", "reward"])
        assert relabelled["next", "last_ball_carrier"].shape == collected.shape


def capped_by_hand(data: TensorDictBase, cap: float) -> dict[str, torch.Tensor]:
    """The parts of a reward with a cap, from those without; rows begin with an episode."""
    parts: dict[str, list[float]] = {part: [] for part in PARTS[1:]}
    for row in rows_of(data):
        for episode in episodes_of(row):
            left = cap
            for step in episode["next"].unbind(0):
                due = sum(float(step[part]) for part in parts)
                share = min(due, left) / due if due else 0.0
                left = max(0.0, left - due)
                for part, values in parts.items():
                    values.append(share * float(step[part]))
    shape = data["next", "reward"].shape
    return {part: torch.tensor(values).reshape(shape) for part, values in parts.items()}


class TestReleaseAtGoal:
    def reward(self, **options: Any) -> AssistDensityReward:
        return AssistDensityReward(**{"weight": 100.0, "release_at_goal": True, **options})

    @pytest.mark.parametrize("cap", [None, 0.5])
    @given(played=st.lists(episodes(), min_size=1, max_size=4))
    @settings(deadline=None, max_examples=25)
    def test_a_goal_pays_what_was_earned_since_the_goal_before(self, played, cap):
        at_once = self.reward(episode_cap=cap, release_at_goal=False)(stored_trajectory(played))
        released = self.reward(episode_cap=cap)(stored_trajectory(played))
        for earned, paid in zip(episodes_of(at_once), episodes_of(released), strict=True):
            scored = earned["next", "reward_scoring"].flatten() > 0
            for part in ("reward_start_density", "reward_end_density"):
                withheld, expected = 0.0, []
                for value, goal in zip(earned["next", part].flatten(), scored, strict=True):
                    withheld += value.item()
                    expected.append(withheld if goal else 0.0)
                    withheld = 0.0 if goal else withheld
                torch.testing.assert_close(
                    paid["next", part].flatten(), torch.tensor(expected), atol=1e-6, rtol=1e-5
                )

    def test_in_an_environment_as_on_stored_data(self):
        env = TransformedEnv(ScriptedMatches(), self.reward())
        check_env_specs(env, break_when_any_done="both")
        data = env.rollout(80, break_when_any_done=False)
        shaped = data["next", "reward"] != data["next", "reward_scoring"]
        assert shaped.any(), "nothing released"
        assert (data["next", "reward_scoring"][shaped] > 0).all()
        stored = as_recorded_without(data).exclude("density_withheld", ("next", "density_withheld"))
        once = self.reward()(stored)
        assert (once == data).all()
        assert (self.reward()(once.clone()) == data).all()


class TestEpisodeCap:
    CAP = 0.01

    def reward(self, **options: Any) -> AssistDensityReward:
        return AssistDensityReward(**{"weight": 100.0, "episode_cap": self.CAP, **options})

    @pytest.mark.parametrize("transition", TRANSITIONS)
    @given(played=st.lists(episodes(), min_size=1, max_size=4))
    @settings(deadline=None, max_examples=25)
    def test_any_match(self, played, transition):
        plain = AssistDensityReward(transition=transition)(stored_trajectory(played))
        cap = 0.5 * float((plain["next", "reward"] - plain["next", "reward_scoring"]).sum())
        data = AssistDensityReward(transition=transition, episode_cap=cap)(
            stored_trajectory(played)
        )
        assert torch.equal(data["next", "reward_scoring"], plain["next", "reward_scoring"])
        for episode, whole in zip(episodes_of(data), episodes_of(plain), strict=True):
            paid, due = (
                each["next", "reward_start_density"] + each["next", "reward_end_density"]
                for each in (episode, whole)
            )
            expected = due.double().cumsum(0).clamp_max(cap)
            torch.testing.assert_close(paid.double().cumsum(0), expected, atol=1e-7, rtol=1e-6)

    @pytest.mark.parametrize("make", ARRANGEMENTS)
    def test_stored_rollouts_of_any_arrangement(self, make):
        stored = as_recorded_without(make("possession").rollout(90, break_when_any_done=False))
        uncapped = AssistDensityReward(weight=100.0)(stored.clone())
        data = self.reward()(stored)
        capped = capped_by_hand(uncapped, self.CAP)
        for part, values in capped.items():
            torch.testing.assert_close(data["next", part], values, atol=1e-8, rtol=1e-5)
        torch.testing.assert_close(
            data["next", "reward"], data["next", "reward_scoring"] + sum(capped.values())
        )
        assert not torch.equal(data["next", "reward"], uncapped["next", "reward"]), "nothing capped"

    def test_in_an_environment_as_on_stored_data(self):
        env = TransformedEnv(ScriptedMatches(), self.reward())
        check_env_specs(env, break_when_any_done="both")
        data = env.rollout(80, break_when_any_done=False)
        assert data["next", "density_paid"].max() == pytest.approx(self.CAP)
        for row in rows_of(data):
            for episode in episodes_of(row):
                paid = episode["next", "reward"] - episode["next", "reward_scoring"]
                assert float(paid.sum()) <= self.CAP + 1e-6
        stored = as_recorded_without(data).exclude("density_paid", ("next", "density_paid"))
        once = self.reward()(stored)
        assert (once == data).all()
        assert (self.reward()(once.clone()) == data).all()

    def test_far_from_the_cap_nothing_changes(self):
        collected = scripted("possession").rollout(80, break_when_any_done=False)
        capped = AssistDensityReward(episode_cap=1e6)(as_recorded_without(collected))
        for part in ("reward", *PARTS):
            assert torch.equal(capped["next", part], collected["next", part])

    def test_a_cap_of_0_leaves_goals(self):
        collected = scripted("possession").rollout(80, break_when_any_done=False)
        capped = AssistDensityReward(episode_cap=0)(collected.clone())
        assert torch.equal(capped["next", "reward"], collected["next", "reward_scoring"])

    def test_what_another_reward_has_paid_is_not_believed(self):
        played = TransformedEnv(ScriptedMatches(), self.reward()).rollout(
            80, break_when_any_done=False
        )
        changed = self.reward(weight=1.0)(played.clone())
        anew = self.reward(weight=1.0)(
            as_recorded_without(played).exclude("density_paid", ("next", "density_paid"))
        )
        assert (changed == anew).all()
        with pytest.raises(ValueError, match=r"a memory that depends on the reward.*consecutive"):
            self.reward()(played.reshape(-1)[torch.randperm(240)])
        with pytest.raises(KeyError, match="a single transition cannot be relabelled"):
            self.reward()(played[0, 0])


def one_step(**changes: Any) -> TensorDict:
    data = stored_trajectory([(A_HAS_IT, [(B_HAS_IT, 0.0)])])
    for key, value in changes.items():
        if value is None:
            del data["next"][key]
        else:
            data["next", key] = value
    return data


class TestErrors:
    @pytest.mark.parametrize("key", ["ball", *INTEGERS, "reward"])
    def test_a_missing_entry_is_named(self, key):
        with pytest.raises(KeyError, match=rf"no '{key}' in 'next'.*keys={{'{key}': <its key>}}"):
            AssistDensityReward()(one_step(**{key: None}))

    @pytest.mark.parametrize("key", ["ball", *INTEGERS])
    def test_an_observation_that_the_environment_lacks_is_named(self, key):
        base = ScriptedMatches()
        spec = base.observation_spec.clone()
        del spec[key]
        base.observation_spec = spec
        with pytest.raises(KeyError, match=f"no '{key}' in the environment's observations"):
            _ = TransformedEnv(base, AssistDensityReward()).observation_spec

    def test_a_reward_that_the_environment_lacks_is_named(self):
        env = TransformedEnv(ScriptedMatches(), AssistDensityReward(keys={"reward": "score"}))
        with pytest.raises(KeyError, match="no reward 'score' in the environment"):
            _ = env.full_reward_spec

    def test_without_next(self):
        with pytest.raises(KeyError, match="no 'next' entry"):
            AssistDensityReward()(one_step().exclude("next"))

    @pytest.mark.parametrize(
        ("key", "value", "error", "message"),
        [
            (
                "ball",
                torch.zeros(1, 3, dtype=torch.int64),
                TypeError,
                "'ball' in 'next' is torch.int",
            ),
            ("ball", torch.zeros(1, 1), TypeError, r"shape \(1, 1\)"),
            (
                "active",
                torch.zeros(1),
                TypeError,
                "in 'next': 'active' has dtype torch.float32.*long",
            ),
            (
                "active",
                torch.zeros(1, dtype=torch.bool),
                TypeError,
                "torch.bool, but must be an int",
            ),
            ("game_mode", torch.zeros(1, 2).long(), ValueError, r"'game_mode'.*shape \(1, 2\)"),
            (
                "reward",
                torch.zeros(1),
                ValueError,
                r"'reward' has shape \(1,\).*reward of shape \(1, 1\)",
            ),
        ],
    )
    def test_a_wrong_entry_is_named_with_what_is_right(self, key, value, error, message):
        with pytest.raises(error, match=message):
            AssistDensityReward()(one_step(**{key: value}))

    @pytest.mark.parametrize(
        ("options", "error", "message"),
        [
            ({"transition": "posession"}, ValueError, "'posession'.*'possession', 'consecutive'"),
            ({"weight": -1.0}, ValueError, "weight is -1.0"),
            ({"weight": float("nan")}, ValueError, "weight is nan"),
            ({"start_weight": -1.0}, ValueError, "start_weight is -1.0"),
            ({"end_weight": "1"}, TypeError, "end_weight is '1'"),
            ({"weight": "1"}, TypeError, "weight is '1'"),
            ({"episode_cap": -1}, ValueError, "episode_cap is -1"),
            ({"episode_cap": True}, TypeError, "episode_cap is True"),
            ({"release_at_goal": "no"}, TypeError, "release_at_goal is 'no'; expected True or"),
            ({"density": 3}, TypeError, "density is a int.*AssistDensity"),
            ({"density": "nowhere.npz"}, FileNotFoundError, "nowhere.npz"),
            ({"keys": {"bal": "ball"}}, ValueError, r"keys renames \['bal'\].*it knows.*'ball'"),
            (
                {"keys": {"ball": None}},
                ValueError,
                r"None for \['ball'\].*do without.*may lack.*'game_mode'",
            ),
        ],
    )
    def test_a_wrong_option_is_named_with_what_is_allowed(self, options, error, message):
        with pytest.raises(error, match=message):
            AssistDensityReward(**options)

    def test_a_step_without_memory_is_refused(self):
        env = scripted("possession", batched=False)
        start = env.reset().exclude("last_ball_carrier")
        start["action"] = env.action_spec.zero()
        with pytest.raises(KeyError, match=r"no 'last_ball_carrier'.*env.reset\(\)"):
            env.step(start)

    def test_two_rewards_of_the_family_are_refused(self):
        both = Compose(AssistDensityReward(), CheckpointReward())
        with pytest.raises(ValueError, match="already has a 'reward_scoring'"):
            _ = TransformedEnv(ScriptedMatches(), both).full_reward_spec

    def test_trajectories_without_done_are_refused(self):
        with pytest.raises(KeyError, match="no 'done' in 'next'"):
            AssistDensityReward()(one_step(done=None))


def test_a_density_file_is_taken_by_path(tmp_path):
    path = tmp_path / "density.npz"
    SHIPPED.save(path)
    transform = AssistDensityReward(path)
    assert torch.equal(transform.density.end.grid, SHIPPED.end.grid)


def attacker() -> TensorDictModule:
    """Runs to the right and passes often, so that passes are received."""
    random = np.random.default_rng(0)

    def policy(ball: torch.Tensor) -> torch.Tensor:
        actions = random.choice([5, 5, 4, 6, 9, 11, 11, 12, 0], ball.shape[:-1])
        return torch.nn.functional.one_hot(torch.as_tensor(actions), 19)

    return TensorDictModule(policy, in_keys=["ball"], out_keys=["action"])


class TestRealMatches:
    @pytest.mark.parametrize("transition", TRANSITIONS)
    @pytest.mark.parametrize("scenario", ["academy_3_vs_1_with_keeper", "11_vs_11_easy_stochastic"])
    def test_vectorised(self, scenario, transition):
        base = GymWrapper(FootballVectorEnv(scenario, num_envs=2))
        sums = RewardSum(in_keys=["reward", *PARTS])
        reward = AssistDensityReward(transition=transition)
        env = TransformedEnv(base, Compose(reward, sums))
        env.set_seed(1)
        check_env_specs(env)
        data = env.rollout(600, attacker(), break_when_any_done=False)
        env.close()
        assert data["next", "reward_start_density"].any()
        assert transition == "consecutive" or data["next", "reward_end_density"].any()
        assert_paid_as_the_oracle_says(data, transition)
        goals = data["score"].diff(dim=-1).squeeze(-1)
        following = data["next", "score"].diff(dim=-1).squeeze(-1)
        torch.testing.assert_close(
            data["next", "reward_scoring"].squeeze(-1), (goals - following).float()
        )
        relabelled = reward.clone()(as_recorded_without(data))
        torch.testing.assert_close(relabelled["next", "reward"], data["next", "reward"])

    def test_single(self):
        env = TransformedEnv(
            GymWrapper(FootballEnv("academy_pass_and_shoot_with_keeper")), AssistDensityReward()
        )
        env.set_seed(3)
        check_env_specs(env)
        data = env.rollout(500, attacker(), break_when_any_done=False)
        env.close()
        assert data["next", "reward_end_density"].any()
        assert_paid_as_the_oracle_says(data)
