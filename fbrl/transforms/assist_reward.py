"""The reward learned from real football: densities of where goals are made."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from fbrl.density import AssistDensity, open_density
from fbrl.transforms.ball_control import NOBODY, Observation, ball_lost, in_control, last_carrier
from fbrl.transforms.memory import Memory, latest_before_steps
from fbrl.transforms.shaped_reward import ShapedReward

Transition = Literal["possession", "consecutive"]


class AssistDensityReward(ShapedReward):
    r"""Pay for having the ball, and for receiving it, where real teams make their goals.

    .. math::
        R'(s, a, s') = R(s, a, s')
            + w \, \mathrm{active}(s') \left( f_{start}(b')
            + f_{end}(b') \, \mathrm{transition}(s, s') \right)

    with the ball's position :math:`b'` in s', the densities of where goal-assisting passes start
    and end, :math:`f_{start} \in [0, 0.001]` and :math:`f_{end} \in [0, 0.1]` for the shipped pair,
    and :math:`\mathrm{active}(s') = 1` if the controlled player has the ball: equations 4.1 to 4.9
    of a thesis of the University of Groningen, *Enhancing football simulation performance in deep
    reinforcement learning through analytics-based dense reward shaping*.

    ``transition(s, s')`` says that the controlled player received a pass:

    - ``"possession"``: a controlled player has the ball in play, and the last controlled player who
      had it was another one. He is forgotten when the other team has the ball, at a dead ball
      (``game_mode != 0``) and at the end of the episode.
    - ``"consecutive"``: the literal reading, the controlled player's index in s' differs from that
      in s. The engine gives control to the receiver when the pass is played, so this seldom pays.

    Entries, each per match (``...`` is any batch shape, also none). Read under ``"next"``, and but
    for the reward at a reset:

    - ``reward`` (..., 1): the scoring reward.
    - ``ball`` (..., 2 or more): x and y first, the pitch being [-1, 1] x [-0.42, 0.42].
    - ``ball_owned_team`` (...) integer: -1 nobody, 0 the own team, 1 the other.
    - ``ball_owned_player`` and ``active`` (...) integer: players of the own team.
    - ``game_mode`` (...) integer: 0 is normal play.

    Written under ``"next"``:

    - ``reward`` (..., 1): the sum of the three parts.
    - ``reward_scoring`` (..., 1): the reward that was read.
    - ``reward_start_density`` (..., 1) float32: 0 to the start density's peak times its weights;
      with ``release_at_goal`` the sum of these since the goal before.
    - ``reward_end_density`` (..., 1) float32: likewise of the end density.
    - ``last_ball_carrier`` (...) int64: the last controlled player with the ball, -1 for none.

    Integers may have a trailing dimension of size 1. A ball outside the pitch, or with a NaN
    coordinate, earns no density. ``last_ball_carrier`` is also at the root, where it is the memory
    before the action; with ``"consecutive"`` the memory is called ``last_active`` and holds the
    controlled player's index. Stored data can be relabelled, see :meth:`forward`.

    .. warning:: It can be farmed, by holding the ball or passing it to and fro. Judge agents by
       goals, not by this return. A small ``weight``, ``episode_cap``, ``release_at_goal`` and
       :class:`~fbrl.transforms.AssistDensityPotential` are answers to it.

    Args:
        density: the densities, the path of a file that holds them, or a name that
            :func:`fbrl.density.open_density` knows; by default those that fbrl ships.
        transition: the reading of ``transition(s, s')``.
        weight: factor of both densities, at least 0.
        start_weight: further factor of the start density, at least 0.
        end_weight: that of the end density.
        episode_cap: what both densities' rewards of an episode sum up to at most, without
            discount, in goals; at least 0, by default no limit. The step that would exceed it is
            paid in part, in equal shares, and later ones not at all. The sum so far is an entry
            ``density_paid`` (...) float32, at the root and under ``"next"``, and only whole
            trajectories can be relabelled.
        release_at_goal: withhold what the densities earn until the own team scores, and pay it
            then; without a goal it is lost. It is an entry ``density_withheld`` (..., 2) float32,
            for both densities, and only whole trajectories can be relabelled.
        keys: other names for the entries above, by their usual name; ``None`` for an integer that
            the environment lacks, which is then 0. With all of them ``None`` a single player has
            the ball all the time.

    Raises:
        ValueError: if an option is none of those allowed, or the density file is damaged.
        TypeError: if an option is of another type.
        FileNotFoundError: if there is no such density.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from fbrl.transforms import AssistDensityReward
        >>> state = {"ball": torch.tensor([0.75, 0.0, 0.0]), "ball_owned_team": torch.tensor(0),
        ...          "ball_owned_player": torch.tensor(9), "active": torch.tensor(9),
        ...          "game_mode": torch.tensor(0)}
        >>> step = TensorDict({"last_ball_carrier": torch.tensor(7),  # player 7 passed to player 9
        ...                    "next": {"reward": torch.zeros(1), **state}})
        >>> step = AssistDensityReward()(step)
        >>> for part in ("reward_scoring", "reward_start_density", "reward_end_density"):
        ...     print(f"{part}: {step['next', part].item():.4f}")
        reward_scoring: 0.0000
        reward_start_density: 0.0007
        reward_end_density: 0.0544
    """

    density: AssistDensity

    def __init__(
        self,
        density: AssistDensity | str | os.PathLike[str] | None = None,
        *,
        transition: Transition = "possession",
        weight: float = 1.0,
        start_weight: float = 1.0,
        end_weight: float = 1.0,
        episode_cap: float | None = None,
        release_at_goal: bool = False,
        keys: Mapping[str, NestedKey | None] | None = None,
    ) -> None:
        if transition not in get_args(Transition):
            raise ValueError(
                f"transition is {transition!r}; expected one of {get_args(Transition)}."
            )
        carrier = "last_ball_carrier" if transition == "possession" else "last_active"
        memory = [carrier]
        if episode_cap is not None:
            memory.append("density_paid")
        if release_at_goal:
            memory.append("density_withheld")
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active", "game_mode"),
            parts=("reward_start_density", "reward_end_density"),
            memory=memory,
            keys=keys,
        )
        self.density = density_from(density)
        self.transition = transition
        weight = check_number("weight", weight)
        self.start_weight = weight * check_number("start_weight", start_weight)
        self.end_weight = weight * check_number("end_weight", end_weight)
        self.episode_cap = None if episode_cap is None else check_number("episode_cap", episode_cap)
        if not isinstance(release_at_goal, bool):
            raise TypeError(f"release_at_goal is {release_at_goal!r}; expected True or False.")
        self.release_at_goal = release_at_goal
        self._carrier = carrier
        # What was paid by another density, weight or cap tells nothing about this one.
        self._stored_memory_is_valid = episode_cap is None and not release_at_goal

    def _first_memory(self, observation: Observation) -> Memory:
        active = observation["active"]
        nobody = torch.full_like(active, NOBODY)
        first = self._remember({self._carrier: nobody}, observation, nobody)
        if self.episode_cap is not None:
            first["density_paid"] = torch.zeros_like(active, dtype=torch.float32)
        if self.release_at_goal:
            first["density_withheld"] = active.new_zeros(*active.shape, 2, dtype=torch.float32)
        return first

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        active = observation["active"]
        if self.transition == "consecutive":
            return {self._carrier: active.clone()}
        control, lost = in_control(observation), ball_lost(observation)
        return {self._carrier: last_carrier(memory[self._carrier], active, control, lost)}

    def _memory_before(
        self, first: Memory, observation: Observation, scoring: Tensor, done: Tensor, time: int
    ) -> Memory:
        if not self._stored_memory_is_valid:
            return super()._memory_before(first, observation, scoring, done, time)
        if self.transition == "consecutive":
            # Each step's own root has the controlled player before it.
            return first
        lost = ball_lost(observation)
        changes = in_control(observation) | lost
        carrier = observation["active"].masked_fill(lost, NOBODY)
        carrier = latest_before_steps(first[self._carrier], done, carrier, changes, time)
        return {self._carrier: carrier}

    def _advance(
        self, memory: Memory, observation: Observation, scoring: Tensor
    ) -> tuple[Memory, tuple[Tensor, ...]]:
        remembered, parts = super()._advance(memory, observation, scoring)
        if self.episode_cap is not None:
            due, paid = parts[0] + parts[1], memory["density_paid"]
            granted = torch.minimum(due, (self.episode_cap - paid).clamp_min(0))
            remembered["density_paid"] = (paid + granted).to(paid.dtype)
            # Exactly 1 while the cap is far, so that nothing is changed then.
            share = granted / due.clamp_min(torch.finfo(due.dtype).tiny)
            parts = tuple(part * share for part in parts)
        if self.release_at_goal:
            earned = memory["density_withheld"] + torch.stack(parts, -1)
            released = earned * (scoring > 0).unsqueeze(-1)
            remembered["density_withheld"] = (earned - released).to(torch.float32)
            parts = released.unbind(-1)
        return remembered, parts

    def _recall(
        self,
        tensordict: TensorDictBase,
        following: TensorDictBase,
        observation: Observation,
        scoring: Tensor,
    ) -> Memory:
        if self.transition == "consecutive" and self._stored_memory_is_valid:
            # The root observation alone tells it, in whatever order the steps are.
            return self._first_memory(self._observe(tensordict, "the root"))
        return super()._recall(tensordict, following, observation, scoring)

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        before, after = memory[self._carrier], remembered[self._carrier]
        active = in_control(observation)
        received = active & (torch.minimum(before, after) > NOBODY) & (before != after)
        position = observation["ball"][..., :2]
        start = self.density.start(position) * (active * self.start_weight)
        end = self.density.end(position) * (received * self.end_weight)
        return start, end


def check_number(name: str, value: float, highest: float = sys.float_info.max) -> float:
    """A number from 0 to ``highest``, as a float; a TypeError or ValueError for another one."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name} is {value!r}; expected a number.")
    if not 0 <= value <= highest:
        unbounded = highest == sys.float_info.max
        allowed = "of at least 0" if unbounded else f"from 0 to {highest:g}"
        raise ValueError(f"{name} is {value!r}; expected a finite number {allowed}.")
    return float(value)


def density_from(density: AssistDensity | str | os.PathLike[str] | None) -> AssistDensity:
    """The densities that a reward is given; see :func:`fbrl.density.open_density` for errors."""
    if density is None:
        return AssistDensity.default()
    if isinstance(density, (str, os.PathLike)):
        return open_density(density)
    if not isinstance(density, AssistDensity):
        raise TypeError(
            f"density is a {type(density).__name__}; expected an AssistDensity, a name or the path "
            "of a density file, or None for the shipped one."
        )
    return density
