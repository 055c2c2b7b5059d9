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
from fbrl.transforms.along_time import Memory
from fbrl.transforms.ball_control import NOBODY, Observation, ball_lost, in_control, last_carrier
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
    and :math:`\mathrm{active}(s') = 1` if the controlled player has the ball (equations 4.1 to 4.9
    of the thesis that introduced it). The scoring reward R is unchanged.

    ``transition(s, s')`` says that the controlled player received a pass:

    - ``"possession"``: a controlled player has the ball in play, and the last controlled player who
      had it was another one. The other team's possession, a dead ball (``game_mode != 0``) and the
      end of the episode are forgotten; the ball in flight, or at a team-mate who is not controlled,
      is waited for.
    - ``"consecutive"``: the literal reading, the controlled player's index in s' differs from that
      in s. The engine gives control to the receiver when the pass is played, while nobody has the
      ball, so this seldom pays.

    Entries, each per match (``...`` is any batch shape, also none). Read under ``"next"``, and at
    a reset:

    - ``reward`` (..., 1): the scoring reward (not at a reset).
    - ``ball`` (..., 2 or more): x and y first, the pitch being [-1, 1] x [-0.42, 0.42].
    - ``ball_owned_team`` (...) integer: -1 nobody, 0 the own team, 1 the other.
    - ``ball_owned_player`` and ``active`` (...) integer: players of the own team.
    - ``game_mode`` (...) integer: 0 is normal play.

    Written under ``"next"``:

    - ``reward`` (..., 1): the sum of the three parts.
    - ``reward_scoring`` (..., 1): the reward that was read.
    - ``reward_start_density`` (..., 1) float32: 0 to the start density's peak times weight.
    - ``reward_end_density`` (..., 1) float32: 0 to the end density's peak times weight.
    - ``last_ball_carrier`` (...) int64: the last controlled player with the ball, -1 for none.

    Integers may have a trailing dimension of size 1. A ball outside the pitch, or with a NaN
    coordinate, earns no density. ``last_ball_carrier`` is also at the root, where it is the memory
    before the action; with ``"consecutive"`` the memory is called ``last_active`` and holds the
    controlled player's index. Stored data can be relabelled, see :meth:`forward`.

    .. warning:: The reward can be farmed. Holding the ball at the start density's peak is worth
        0.134 discounted (gamma 0.993), and a pass back and forth every 20 steps 0.76 goals. Judge
        agents by goals, not by this return.

    Args:
        density: the densities, the path of a file that holds them, or a name that
            :func:`fbrl.density.open_density` knows. Default: those that fbrl ships
            (:meth:`fbrl.density.AssistDensity.default`).
        transition: the reading of ``transition(s, s')``.
        weight: factor of both densities, at least 0.
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

        Around an environment with these observations, with the parts summed per episode::

            env = TransformedEnv(
                env,
                Compose(
                    AssistDensityReward(),
                    RewardSum(in_keys=["reward_scoring", "reward_end_density"]),
                ),
            )
    """

    def __init__(
        self,
        density: AssistDensity | str | os.PathLike[str] | None = None,
        *,
        transition: Transition = "possession",
        weight: float = 1.0,
        keys: Mapping[str, NestedKey | None] | None = None,
    ) -> None:
        if transition not in get_args(Transition):
            raise ValueError(
                f"transition is {transition!r}; expected one of {get_args(Transition)}."
            )
        if isinstance(weight, bool) or not isinstance(weight, (int, float)):
            raise TypeError(f"weight is {weight!r}; expected a number.")
        if not 0 <= weight <= sys.float_info.max:
            raise ValueError(f"weight is {weight!r}; expected a finite number of at least 0.")
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active", "game_mode"),
            parts=("reward_start_density", "reward_end_density"),
            memory=("last_ball_carrier" if transition == "possession" else "last_active",),
            keys=keys,
        )
        self.density = density_from(density)
        self.transition = transition
        self.weight = float(weight)

    def _first_memory(self, observation: Observation) -> Memory:
        nobody = torch.full_like(observation["active"], NOBODY)
        return self._remember(dict.fromkeys(self._memory, nobody), observation, nobody)

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        active = observation["active"]
        if self.transition == "consecutive":
            return {"last_active": active.clone()}
        control, lost = in_control(observation), ball_lost(observation)
        carrier = last_carrier(memory["last_ball_carrier"], active, control, lost)
        return {"last_ball_carrier": carrier}

    def _recall(
        self,
        tensordict: TensorDictBase,
        following: TensorDictBase,
        observation: Observation,
        scoring: Tensor,
    ) -> Memory:
        if self.transition == "consecutive":
            # The root observation alone tells it, in whatever order the steps are.
            return self._first_memory(self._observe(tensordict, "the root"))
        return super()._recall(tensordict, following, observation, scoring)

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        (name,) = memory
        active = in_control(observation)
        both_known = torch.minimum(memory[name], remembered[name]) > NOBODY
        received = active & both_known & (memory[name] != remembered[name])
        position = observation["ball"][..., :2]
        start = self.density.start(position) * (active * self.weight)
        end = self.density.end(position) * (received * self.weight)
        return start, end


def density_from(density: AssistDensity | str | os.PathLike[str] | None) -> AssistDensity:
    """The densities that a reward is given, in any of the ways that it takes them."""
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
