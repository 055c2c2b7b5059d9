"""``PlayStatistics`` against a walk through the same matches in plain Python."""

from __future__ import annotations

import functools
import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from fbrl.envs import make_env
from fbrl.transforms import PLAY_STATISTICS, PlayStatistics

RAW = ("ball", "ball_direction", "active", "ball_owned_team", "ball_owned_player", "game_mode")
RIGHT, SHORT_PASS, SHOT = 5, 11, 12


def flies_at_goal(state):
    x, y, _ = state["ball"]
    dx, dy, _ = state["ball_direction"]
    metres_per_step = math.sqrt((54.4 * dx) ** 2 + (83.6 * dy) ** 2)
    if dx <= 0 or x < 0.4 or metres_per_step < 2.0:
        return False
    steps_to_line = (1 - x) / dx
    return abs(y + steps_to_line * dy) <= 0.1


def walk(first, steps):
    """Totals after each step of one episode, given its states and scoring rewards."""
    totals = dict.fromkeys(PLAY_STATISTICS, 0)
    carrier = None
    last_team, counted = 0, False
    rows = []
    for state, scoring in [(first, None), *steps]:
        team, dead = state["ball_owned_team"], state["game_mode"] != 0
        with_ball = team == 0 and state["ball_owned_player"] == state["active"]
        if scoring is not None:
            totals["goals_for"] += scoring > 0
            totals["goals_against"] += scoring < 0
            totals["possession"] += team == 0
            totals["opponent_possession"] += team == 1
            flight = team == -1 and not dead and flies_at_goal(state)
            if last_team == 0 and not counted and (flight or scoring > 0):
                totals["shots"] += 1
                counted = True
            if with_ball and not dead and carrier not in (None, state["active"]):
                totals["passes"] += 1
        if dead or team == 1:
            carrier, last_team = None, None
        elif team == 0:
            last_team, counted = 0, False
            carrier = state["active"] if with_ball else carrier
        rows.append([float(totals[name]) for name in PLAY_STATISTICS])
    return rows[1:]


def state_at(tensordict):
    return {key: tensordict[key].tolist() for key in RAW}


def episodes_of(match):
    """The parts of a stream of steps that end with an episode, and what is left."""
    ends = (match["next", "done"].squeeze(-1).nonzero().squeeze(-1) + 1).tolist()
    starts = [0, *ends]
    return [match[a:b] for a, b in zip(starts, [*ends, len(match)], strict=True) if a < b]


def attacker(tensordict):
    """Runs towards the goal, and passes and shoots now and then."""
    chance = torch.rand(tensordict.batch_size)
    action = torch.full(tensordict.batch_size, RIGHT)
    with_ball = tensordict["ball_owned_player"] == tensordict["active"]
    action[with_ball & (chance < 0.1)] = SHORT_PASS
    action[with_ball & (chance > 0.9)] = SHOT
    return tensordict.set("action", action)


@pytest.mark.parametrize(
    ("scenario", "steps", "happens"),
    [
        (
            "academy_3_vs_1_with_keeper",
            250,
            ("possession", "opponent_possession", "passes", "shots"),
        ),
        ("11_vs_11_easy_stochastic", 300, ("possession", "opponent_possession")),
    ],
)
def test_totals_equal_a_walk_through_real_matches(scenario, steps, happens):
    torch.manual_seed(3)
    env = make_env(scenario, num_envs=3, reward="scoring", keep_keys=RAW, seed=5)
    data = env.rollout(steps, attacker, break_when_any_done=False)
    env.close()
    seen = torch.zeros(len(PLAY_STATISTICS))
    for episode in (part for match in data for part in episodes_of(match)):
        totals = episode["next", "play_statistics"]
        following = [(state_at(step), step["reward_scoring"].item()) for step in episode["next"]]
        assert totals.tolist() == walk(state_at(episode[0]), following)
        seen += totals[-1]
    assert min(seen[PLAY_STATISTICS.index(name)] for name in happens) > 0


def test_a_goal_is_a_shot_and_starts_from_zero_in_the_next_match():
    env = make_env("academy_empty_goal_close", num_envs=2, reward="scoring", seed=1)

    def shoot(tensordict):
        return tensordict.set("action", torch.full((2,), SHOT))

    data = env.rollout(60, shoot, break_when_any_done=False)
    env.close()
    last = data["next", "play_statistics"][data["next", "done"].squeeze(-1)]
    assert len(last) > 2
    columns = [PLAY_STATISTICS.index(name) for name in ("goals_for", "goals_against", "shots")]
    assert last[:, columns].tolist() == [[1.0, 0.0, 1.0]] * len(last)
    after_reset = data["play_statistics"][:, 1:][data["next", "done"][:, :-1].squeeze(-1)]
    assert not after_reset.any()


class ScriptedStates(EnvBase):
    """Steps through given states, one a step, and begins again at their end."""

    def __init__(self, states):
        super().__init__()
        self.states = states
        shapes = {"ball": (3,), "ball_direction": (3,)}
        self.observation_spec = Composite(
            {
                key: Unbounded(shapes.get(key, ()), dtype=states[0][key].dtype)
                for key in RAW
            }
        )  # fmt: skip
        self.action_spec = Bounded(0, 18, (), dtype=torch.int64)
        self.reward_spec = Composite(reward=Unbounded(1), reward_scoring=Unbounded(1))
        self.at = 0

    def _reset(self, tensordict):
        self.at = 0
        return TensorDict(self.states[0])

    def _step(self, tensordict):
        self.at += 1
        ended = torch.tensor([self.at == len(self.states) - 1])
        reward = torch.zeros(1)
        return TensorDict(
            {
                **self.states[self.at],
                **{"reward": reward, "reward_scoring": reward.clone()},
                **{"done": ended, "terminated": ended.clone()},
            }
        )

    def _set_seed(self, seed):
        pass


def state(team, *, x=0.7, y=0.0, dx=0.0, dy=0.0, player=3, active=3, mode=0):
    return {
        "ball": torch.tensor([x, y, 0.1]),
        "ball_direction": torch.tensor([dx, dy, 0.0]),
        "active": torch.tensor(active),
        "ball_owned_team": torch.tensor(team),
        "ball_owned_player": torch.tensor(player if team >= 0 else -1),
        "game_mode": torch.tensor(mode),
    }


def with_statistics(states):
    return TransformedEnv(ScriptedStates(states), PlayStatistics())


def totals_of(*states):
    env = with_statistics(states)
    last = env.rollout(len(states) - 1)[-1]["next", "play_statistics"]
    return dict(zip(PLAY_STATISTICS, last.tolist(), strict=True))


FAST = 0.05
SHOTS = {
    "at the goal": (state(-1, dx=FAST), 1),
    "too slow": (state(-1, dx=1.9 / 54.4), 0),
    "just quick enough": (state(-1, dx=2.01 / 54.4), 1),
    "backwards": (state(-1, dx=-FAST), 0),
    "from too far": (state(-1, x=0.39, dx=FAST), 0),
    "just wide": (state(-1, y=0.09, dx=FAST), 1),
    "far wide": (state(-1, y=0.11, dx=FAST), 0),
    "across, out of the goal's way": (state(-1, dx=0.02, dy=0.03), 0),
    "slowly forward, quickly across, to the goal": (state(-1, y=-0.4, dx=0.02, dy=0.026), 1),
    "the opponent's": (state(1, dx=FAST), 0),
    "after a stop of the game": (state(-1, dx=FAST, mode=4), 0),
}


@pytest.mark.parametrize("case", SHOTS)
def test_a_shot_is_a_quick_flight_at_the_goal(case):
    flight, shots = SHOTS[case]
    assert totals_of(state(0), flight)["shots"] == shots


def test_a_flight_counts_once_and_only_after_ones_own_possession():
    flight = state(-1, dx=FAST)
    assert totals_of(state(0), flight, flight, flight)["shots"] == 1
    assert totals_of(state(0), flight, state(0), flight)["shots"] == 2
    assert totals_of(state(0), state(-1), flight)["shots"] == 1
    assert totals_of(state(1), flight)["shots"] == 0
    assert totals_of(state(0), state(1), flight)["shots"] == 0


def test_passes_and_possession_are_counted():
    passed = totals_of(state(0), state(-1), state(0, player=5, active=5))
    assert (passed["passes"], passed["possession"], passed["opponent_possession"]) == (1, 1, 0)
    intercepted = totals_of(state(0), state(1, player=5), state(0, player=5, active=5))
    assert (intercepted["passes"], intercepted["opponent_possession"]) == (0, 1)
    to_somebody_else = totals_of(state(0), state(0, player=5, active=3))
    assert (to_somebody_else["passes"], to_somebody_else["possession"]) == (0, 1)


def test_the_specs_hold_in_single_serial_and_parallel_environments():
    states = [state(0), state(-1, dx=FAST), state(1)]
    check_env_specs(with_statistics(states))
    for batched in (SerialEnv, ParallelEnv):
        env = batched(2, functools.partial(with_statistics, states))
        shots = env.rollout(5, break_when_any_done=False)["next", "play_statistics"][..., 5]
        assert shots.tolist() == [[1.0, 1.0, 1.0, 1.0, 1.0]] * 2
        env.close()


def test_a_step_without_the_totals_says_what_is_missing():
    env = with_statistics([state(0), state(1)])
    start = env.reset().exclude("play_statistics").set("action", torch.tensor(0))
    with pytest.raises(KeyError, match=r"Step what env\.reset\(\)"):
        env.step(start)
