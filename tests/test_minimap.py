"""The Super Mini Map against gfootball's own, and its stacking in every way TorchRL steps envs."""

from __future__ import annotations

import collections
import doctest
import functools
from typing import Any

import gymnasium
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
    coordinates,
    random_match,
    raw_matches,
)
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import (
    Compose,
    GymWrapper,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    Transform,
    TransformedEnv,
    step_mdp,
)
from torchrl.envs.utils import check_env_specs

import fbrl.transforms.minimap
import fbrl.transforms.minimap_grid
from fbrl.envs import FootballEnv
from fbrl.transforms import MiniMapCells, SuperMiniMap
from fbrl.transforms.minimap_grid import cells_to_planes, frame_cells

NUM_FRAMES = 4


@pytest.fixture(scope="module")
def preprocessing() -> Any:
    return import_gfootball("observation_preprocessing")


def cells_of(matches: TensorDict) -> torch.Tensor:
    keys = ("left_team", "right_team", "ball", "active", "left_team_roles", "right_team_roles")
    return frame_cells(*(matches[key] for key in keys))


def planes_of(frame: torch.Tensor) -> np.ndarray:
    """A single frame drawn as gfootball shapes it: height, width, layers."""
    return cells_to_planes(frame.unsqueeze(-2)).movedim(-3, -1).numpy()


def oracle_stacks(rollout: TensorDict) -> tuple[torch.Tensor, torch.Tensor]:
    """The stacks of a rollout of one match, kept in a deque: of each step, and of what it led to.

    The rollout must begin with an episode.
    """
    frames: collections.deque = collections.deque(maxlen=NUM_FRAMES)
    first = True
    stacks, next_stacks = [], []
    for step in rollout.unbind(0):
        if first:
            frames.extend([cells_of(step)] * NUM_FRAMES)
        stacks.append(torch.stack(tuple(frames)))
        frames.append(cells_of(step["next"]))
        next_stacks.append(torch.stack(tuple(frames)))
        first = step["next", "done"].item()
    return torch.stack(stacks), torch.stack(next_stacks)


def assert_stacked(rollout: TensorDict) -> None:
    for match in rollout.unbind(0):
        stacks, next_stacks = oracle_stacks(match)
        assert torch.equal(match["minimap_cells"], stacks)
        assert torch.equal(match["next", "minimap_cells"], next_stacks)


def make_vector_env(lengths=(2, 3, 7), transform=MiniMapCells) -> TransformedEnv:
    base_env = GymWrapper(SyntheticVectorEnv(lengths), categorical_action_encoding=True)
    return TransformedEnv(base_env, transform())


def make_single_env(length=3, transform=MiniMapCells) -> TransformedEnv:
    base_env = GymWrapper(SyntheticEnv(length), categorical_action_encoding=True)
    return TransformedEnv(base_env, transform())


# Cells


def test_cells_agree_with_gfootball_on_both_sides_of_every_cell_border(preprocessing):
    """Both are monotonous, so that agreement around each of the steps is agreement everywhere."""
    x_borders = np.arange(97) / 96 * 2 - 1
    y_borders = (np.arange(73) / 72 * 2 - 1) / 2.25
    points = []
    for axis, borders in enumerate((x_borders, y_borders)):
        for border in borders.astype(np.float32):
            neighbours = [border]
            for direction in (-np.inf, np.inf):
                value = border
                for _ in range(4):
                    value = np.nextafter(value, np.float32(direction))
                    neighbours.append(value)
            for value in neighbours:
                points.append((value, 0.0) if axis == 0 else (0.0, value))
    raw = random_match(np.random.default_rng(0))
    seen = set()
    for point in points:
        raw["ball"] = np.array([*point, 0.0], np.float64)
        cell = cells_of(as_tensordict(raw))[0, 22].item()
        frame = np.zeros((72, 96), np.uint8)
        preprocessing.mark_points(frame, raw["ball"])
        assert cell == np.flatnonzero(frame).item(), point
        seen.add(cell)
    # All 96 columns and all 72 rows, which share the cell of the origin.
    assert len(seen) == 96 + 72 - 1


@given(points=coordinates(30, 2))
def test_any_finite_point_falls_into_gfootballs_cell(preprocessing, points):
    raw = random_match(np.random.default_rng(0))
    for x, y in points:
        raw["ball"] = np.array([x, y, 0.0])
        frame = np.zeros((72, 96), np.uint8)
        preprocessing.mark_points(frame, raw["ball"])
        assert cells_of(as_tensordict(raw))[0, 22].item() == np.flatnonzero(frame).item()


@given(raws=st.lists(raw_matches(), min_size=1, max_size=3))
@settings(deadline=None)
def test_planes_of_one_frame_equal_generate_smm(preprocessing, raws):
    expected = preprocessing.generate_smm(raws)
    np.testing.assert_array_equal(planes_of(cells_of(as_tensordict(*raws))), expected)


def test_players_that_are_not_there_have_no_cell():
    raw = random_match(np.random.default_rng(0), num_left=3, num_right=2)
    raw["active"] = -1
    cells = cells_of(as_tensordict(raw))[0]
    assert (cells[3:11] == -1).all()
    assert (cells[13:22] == -1).all()
    assert cells[23] == -1
    assert (cells[[0, 1, 2, 11, 12, 22]] >= 0).all()


def test_double_precision_observations_give_the_same_cells():
    match = as_tensordict(random_match(np.random.default_rng(0)))
    double = match.clone().update({key: match[key].double() for key in ("left_team", "ball")})
    double["right_team"] = double["right_team"].double()
    assert torch.equal(cells_of(match), cells_of(double))


def test_cells_are_the_same_in_any_batch_shape():
    random = np.random.default_rng(0)
    matches = as_tensordict(*(random_match(random) for _ in range(6)))
    cells = cells_of(matches)
    assert torch.equal(cells_of(matches.reshape(2, 3)), cells.reshape(2, 3, 24))
    assert torch.equal(cells_of(matches[0]), cells[0])


# Planes


def test_planes_hold_frames_oldest_first_and_layers_within_a_frame():
    cells = torch.full((4, 24), -1, dtype=torch.int16)
    cells[1, 10], cells[2, 11], cells[3, 22], cells[3, 23] = 0, 95, 71 * 96, 6911
    marked = cells_to_planes(cells).nonzero().tolist()
    assert marked == [[4, 0, 0], [9, 0, 95], [14, 71, 0], [15, 71, 95]]


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.bfloat16])
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
def test_memory_layout_and_dtype_do_not_change_the_planes(dtype, batch):
    cells = torch.randint(-1, 6912, (*batch, 4, 24), dtype=torch.int16)
    planes = cells_to_planes(cells)
    assert planes.shape == (*batch, 16, 72, 96)
    scale = 255 if dtype == torch.uint8 else 1
    for channels_last in (False, True):
        drawn = cells_to_planes(cells, dtype, channels_last=channels_last)
        assert drawn.dtype == dtype
        assert torch.equal(drawn.float() * (255 / scale), planes.float())


def test_channels_last_planes_lie_in_memory_as_convolutions_want_them():
    cells = torch.randint(-1, 6912, (3, 4, 24), dtype=torch.int16)
    planes = cells_to_planes(cells, torch.float32, channels_last=True)
    assert planes.is_contiguous(memory_format=torch.channels_last)


def test_cells_of_another_dtype_or_shape_are_refused():
    with pytest.raises(ValueError, match=r"torch.int64 of shape \(4, 24\).*torch.int16"):
        cells_to_planes(torch.zeros(4, 24, dtype=torch.int64))
    with pytest.raises(ValueError, match=r"shape \(4, 23\)"):
        cells_to_planes(torch.zeros(4, 23, dtype=torch.int16))


# Stacking


class FramesOfRawObservations(gymnasium.Env):
    """Gives gfootball's FrameStack the SMM of gfootball's own environment, in gym's old API."""

    def __init__(self, env, preprocessing):
        self.env = env
        self.generate_smm = preprocessing.generate_smm
        self.observation_space = gymnasium.spaces.Box(0, 255, (1, 72, 96, 4), np.uint8)
        self.action_space = env.action_space

    def reset(self):
        self.raw = self.env.reset()
        return self.generate_smm(self.raw)

    def step(self, action):
        self.raw, reward, done, info = self.env.step(action)
        return self.generate_smm(self.raw), reward, done, info


@pytest.mark.parametrize(
    ("scenario", "episodes"),
    [
        ("academy_3_vs_1_with_keeper", 2),
        ("academy_counterattack_hard", 1),
        ("academy_empty_goal_close", 2),
        ("1_vs_1_easy", 1),
    ],
)
def test_real_matches_equal_gfootballs_smm_under_its_frame_stack(preprocessing, scenario, episodes):
    wrappers = import_gfootball("wrappers")
    theirs = wrappers.FrameStack(
        FramesOfRawObservations(make_gfootball_env(scenario, 5), preprocessing), NUM_FRAMES
    )
    ours = TransformedEnv(
        GymWrapper(FootballEnv(scenario), categorical_action_encoding=True), SuperMiniMap()
    )
    compared = 0
    for _ in range(episodes):
        state = ours.reset(seed=5)
        expected = theirs.reset()
        for step in range(60):
            planes = torch.from_numpy(expected[0]).movedim(-1, 0)
            assert torch.equal(state["smm"], planes)
            compared += 1
            action = shoot_near_goal(step, state["ball"][0].item())
            state = step_mdp(ours.step(state.set("action", torch.tensor(action))))
            expected, _, done, _ = theirs.step(action)
            assert state["done"].item() == done
            if done:
                break
    assert compared > 5 * episodes


@pytest.mark.parametrize("num_frames", [1, 2, 4, 7])
def test_a_reset_fills_the_stack_with_the_first_frame(num_frames):
    env = make_single_env(transform=functools.partial(MiniMapCells, num_frames))
    state = env.reset()
    assert state["minimap_cells"].shape == (num_frames, 24)
    assert (state["minimap_cells"] == cells_of(env_scalars(state))).all()


def env_scalars(state: TensorDict) -> TensorDict:
    """GymWrapper gives a single environment's scalars one dimension, the batched ones none."""
    return state.clone().update({"active": state["active"].squeeze(-1)})


def test_vectorised_matches_that_end_at_different_times_keep_their_own_frames():
    rollout = make_vector_env().rollout(25, break_when_any_done=False)
    assert rollout["next", "done"].sum((1, 2)).tolist() == [12, 8, 3]
    assert_stacked(rollout)


def test_a_partial_reset_leaves_the_other_matches_alone():
    env = make_vector_env(lengths=(9, 9, 9))
    state = env.rollout(5, break_when_any_done=False)[:, -1]
    state = step_mdp(state)
    before = state["minimap_cells"].clone()
    state["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(state)["minimap_cells"]
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    assert (after[1] == after[1, 0]).all()
    assert not torch.equal(after[1], before[1])


class Recorder(Transform):
    """Remembers what the transforms before it made of a reset."""

    def _reset(self, tensordict, tensordict_reset):
        self.seen = tensordict_reset["minimap_cells"].clone()
        return tensordict_reset

    _reset_on_native_autoreset = _reset


@pytest.mark.parametrize("by_itself", [False, True])
def test_transforms_behind_see_the_frames_that_a_partial_reset_left_alone(by_itself):
    recorder = Recorder()
    env = make_vector_env((9, 9, 9), lambda: Compose(MiniMapCells(), recorder))
    state = step_mdp(env.rollout(5, break_when_any_done=False)[:, -1])
    before = state["minimap_cells"].clone()
    state["_reset"] = torch.tensor([[False], [True], [False]])
    if by_itself:
        env._reset_on_native_autoreset(state, state)
    else:
        env.reset(state)
    assert torch.equal(recorder.seen[[0, 2]], before[[0, 2]])
    assert (recorder.seen[1] == recorder.seen[1, 0]).all()


@pytest.mark.parametrize("batched", [SerialEnv, ParallelEnv])
def test_batched_environments_keep_the_frames_of_each_match(batched):
    makers = [functools.partial(make_single_env, length) for length in (2, 5)]
    env = batched(2, makers)
    try:
        rollout = env.rollout(12, break_when_any_done=False)
    finally:
        env.close()
    rollout["active"] = rollout["active"].squeeze(-1)
    rollout["next", "active"] = rollout["next", "active"].squeeze(-1)
    assert rollout["next", "done"].sum((1, 2)).tolist() == [6, 2]
    assert_stacked(rollout)


def test_a_transform_outside_of_a_batched_environment_stacks_too():
    makers = [
        functools.partial(make_single_env, length, transform=lambda: RewardSum())
        for length in (2, 5)
    ]
    rollout = TransformedEnv(SerialEnv(2, makers), MiniMapCells()).rollout(
        12, break_when_any_done=False
    )
    rollout["active"] = rollout["active"].squeeze(-1)
    rollout["next", "active"] = rollout["next", "active"].squeeze(-1)
    assert_stacked(rollout)


def test_the_stack_goes_on_from_one_collected_batch_to_the_next():
    collector = Collector(
        make_vector_env(),
        frames_per_batch=15,
        total_frames=60,
        auto_register_policy_transforms=False,
    )
    rollout = torch.cat([batch.clone() for batch in collector], -1)
    collector.shutdown()
    assert rollout.shape == (3, 20)
    assert_stacked(rollout)


def test_a_fresh_transform_goes_on_from_a_stored_step():
    vector_env = SyntheticVectorEnv((9, 9, 9))
    wrapped = GymWrapper(vector_env, categorical_action_encoding=True)
    rollout = TransformedEnv(wrapped, MiniMapCells()).rollout(3, break_when_any_done=False)
    state = step_mdp(rollout[:, -1])
    state["action"] = torch.zeros(3, dtype=torch.int64)
    wrapped = GymWrapper(vector_env, categorical_action_encoding=True)
    step = TransformedEnv(wrapped, MiniMapCells()).step(state)
    assert_stacked(torch.cat([rollout, step.exclude("_reset").unsqueeze(-1)], -1))


def test_frames_computed_for_a_stored_trajectory_equal_those_of_the_environment():
    rollout = make_vector_env().rollout(25, break_when_any_done=False)
    stored = rollout.exclude("minimap_cells", ("next", "minimap_cells"))
    computed = MiniMapCells()(stored)
    assert torch.equal(computed["minimap_cells"], rollout["minimap_cells"])
    assert torch.equal(computed["next", "minimap_cells"], rollout["next", "minimap_cells"])
    again = MiniMapCells()(computed.clone())
    assert torch.equal(again["minimap_cells"], rollout["minimap_cells"])


def test_a_single_stored_trajectory_needs_no_batch_of_matches():
    rollout = make_vector_env().rollout(25, break_when_any_done=False)[0]
    computed = MiniMapCells()(rollout.exclude("minimap_cells"))
    assert torch.equal(computed["minimap_cells"], rollout["minimap_cells"])


def test_a_batch_without_time_is_not_stacked():
    shuffled = make_vector_env().rollout(5).exclude("minimap_cells").reshape(-1)
    with pytest.raises(ValueError, match="refine_names"):
        MiniMapCells()(shuffled)


def test_a_replay_buffer_draws_the_planes_of_sampled_cells():
    rollout = make_vector_env().rollout(20, break_when_any_done=False)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(60), transform=SuperMiniMap(), batch_size=16
    )
    buffer.extend(rollout.select("minimap_cells", ("next", "minimap_cells")).reshape(-1))
    sample = buffer.sample()
    assert torch.equal(sample["smm"], cells_to_planes(sample["minimap_cells"]))
    assert torch.equal(sample["next", "smm"], cells_to_planes(sample["next", "minimap_cells"]))


def test_planes_computed_for_a_stored_trajectory_equal_those_of_the_environment():
    rollout = make_vector_env(transform=SuperMiniMap).rollout(9, break_when_any_done=False)
    keys = ("smm", "minimap_cells")
    computed = SuperMiniMap()(rollout.exclude(*keys, *(("next", key) for key in keys)))
    assert torch.equal(computed["smm"], rollout["smm"])
    assert torch.equal(computed["next", "smm"], rollout["next", "smm"])


# Specs, keys and errors


@pytest.mark.parametrize("transform", [MiniMapCells, SuperMiniMap])
@pytest.mark.parametrize("make", [make_single_env, make_vector_env])
def test_specs_describe_what_comes_out(transform, make):
    env = make(transform=transform)
    check_env_specs(env)
    state = env.reset()
    for key in transform().out_keys:
        assert env.observation_spec[key].is_in(state[key])
        assert env.observation_spec[key].dtype == state[key].dtype
    assert not env.observation_spec["minimap_cells"].is_in(state["minimap_cells"] - 7000)


def test_keys_can_be_renamed():
    raw_keys = ["left_team", "right_team", "ball", "active", "left_team_roles", "right_team_roles"]
    matches = as_tensordict(random_match(np.random.default_rng(0)))
    renamed = TensorDict(
        {("raw", key): matches[key] for key in raw_keys}, batch_size=[1]
    ).unsqueeze(-1)
    transform = MiniMapCells(1, [("raw", key) for key in raw_keys], ["cells"])
    cells = transform(renamed.refine_names(..., "time"))["cells"]
    assert torch.equal(cells[:, 0, 0], cells_of(matches))


def test_two_transforms_in_one_environment_write_their_own_keys():
    env = make_vector_env(
        transform=lambda: Compose(MiniMapCells(), MiniMapCells(2, out_keys=["short"]))
    )
    rollout = env.rollout(9, break_when_any_done=False)
    assert torch.equal(rollout["short"], rollout["minimap_cells"][..., 2:, :])


def with_time(matches: TensorDict) -> TensorDict:
    return matches.unsqueeze(-1).refine_names(..., "time")


def test_wrong_input_is_named_with_its_remedy():
    match = as_tensordict(random_match(np.random.default_rng(0)))
    with pytest.raises(KeyError, match=r"'left_team_roles' is missing.*in_keys"):
        MiniMapCells()(with_time(match.exclude("left_team_roles")))
    short = match.clone().set("right_team", match["right_team"][:, :4])
    with pytest.raises(ValueError, match=r"'right_team' has shape \(1, 1, 4, 2\).*padded"):
        MiniMapCells()(with_time(short))
    integers = match.clone().set("ball", match["ball"].long())
    with pytest.raises(TypeError, match=r"'ball' has dtype torch.int64.*torch.float32"):
        MiniMapCells()(with_time(integers))
    floats = match.clone().set("active", match["active"].float())
    with pytest.raises(TypeError, match=r"'active' has dtype torch.float32.*torch.int64"):
        MiniMapCells()(with_time(floats))
    with pytest.raises(ValueError, match="num_frames is 0"):
        MiniMapCells(0)
    with pytest.raises(ValueError, match="in_keys must name 6 keys"):
        MiniMapCells(in_keys=["left_team"])
    with pytest.raises(ValueError, match="out_keys must name 2 keys"):
        SuperMiniMap(out_keys=["smm"])


def test_a_step_without_the_previous_frames_says_what_to_pass_on():
    env = make_vector_env()
    state = env.reset().exclude("minimap_cells")
    with pytest.raises(KeyError, match=r"no 'minimap_cells'.*step_mdp"):
        env.step(state.set("action", torch.zeros(3, dtype=torch.int64)))


@pytest.mark.parametrize("module", [fbrl.transforms.minimap, fbrl.transforms.minimap_grid])
def test_documented_examples_run(module):
    outcome = doctest.testmod(module)
    assert outcome.attempted > 0
    assert outcome.failed == 0
