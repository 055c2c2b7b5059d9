"""The potential-based sibling of the assist reward, which leaves the best policy as it is."""

from __future__ import annotations

import os
from collections.abc import Mapping

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from fbrl.density import AssistDensity
from fbrl.transforms.assist_reward import check_number, density_from
from fbrl.transforms.ball_control import Observation, ball_lost, in_control
from fbrl.transforms.memory import Memory
from fbrl.transforms.shaped_reward import ShapedReward

# Off the pitch, where either density is 0.
_NOWHERE = -2.0


class AssistDensityPotential(ShapedReward):
    r"""Pay for bringing the ball to where goals are made, and take it back when it is lost.

    .. math::
        R'(s, a, s') = R(s, a, s') + \gamma \Phi(s') - \Phi(s), \qquad
        \Phi(s) = w \left( c \, f_{start}(b) + f_{end}(b) \right)

    with the discount :math:`\gamma` of the training and the densities of
    :class:`~fbrl.transforms.AssistDensityReward` at b, the position of the ball when the controlled
    player had it last:

    - while he has the ball, b is where it is;
    - while the ball is in flight, or at a team-mate who is not controlled, b and so the potential
      are held: a pass is not punished for leaving, and is paid on arrival;
    - the other team's possession and a dead ball (``game_mode != 0``) that the controlled player
      does not have make it 0, as it is before he first has the ball;
    - so does the end of the episode by a rule, ``terminated``.

    With the default :math:`c = 100` both densities have the peak 0.1, and for the shipped pair the
    potential is at most 0.155.

    Along an episode of T steps the payments telescope,
    :math:`\sum_t \gamma^t F_t = \gamma^T \Phi(s_T) - \Phi(s_0)`, so that the best policy is that of
    the scoring reward (Ng, Harada and Russell 1999, "Policy invariance under reward
    transformations"): holding the ball, or passing it to and fro, earns nothing in sum.

    At a time limit (``truncated``, not ``terminated``) the potential is not made 0: there PPO goes
    on with the value of :math:`s_T`, which is lower than the scoring reward's by just as much.

    Entries are those of :class:`~fbrl.transforms.AssistDensityReward`, with ``terminated`` (..., 1)
    boolean read under ``"next"``, and written instead of the parts there:

    - ``reward_potential`` (..., 1) float32: the payment.
    - ``last_ball_position`` (..., 2), the ball's dtype: b, or (-2, -2) where the potential is 0.
      Also at the root: before the action. It is the same whatever the densities, weights and gamma,
      so that stored data can be relabelled with others.

    Pass ``keys={"terminated": "done"}`` for stored data that has no ``terminated``, or where time
    limits are ends, with no value after them.

    Args:
        density: as for :class:`~fbrl.transforms.AssistDensityReward`.
        gamma: the discount that the agent is trained with, 0 to 1; with another one the payments
            don't telescope.
        weight: factor of the potential, at least 0.
        start_weight: factor of the start density within the potential, at least 0.
        keys: as for :class:`~fbrl.transforms.AssistDensityReward`.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from fbrl.transforms import AssistDensityPotential
        >>> received = {"ball": torch.tensor([0.86, 0.0, 0.0]), "ball_owned_team": torch.tensor(0),
        ...             "ball_owned_player": torch.tensor(9), "active": torch.tensor(9),
        ...             "game_mode": torch.tensor(0), "reward": torch.zeros(1)}
        >>> flying = {**received, "ball_owned_team": torch.tensor(-1)}
        >>> reward = AssistDensityPotential(gamma=0.993, keys={"terminated": "done"})
        >>> place = torch.tensor([0.4, 0.1])
        >>> for state in (flying, received):  # held, but for the discount; then paid
        ...     following = {**state, "done": torch.tensor([False])}
        ...     step = reward(TensorDict({"last_ball_position": place, "next": following}))
        ...     place = step["next", "last_ball_position"]
        ...     print(f"{step['next', 'reward'].item():.4f}")
        -0.0004
        0.0976
    """

    density: AssistDensity

    def __init__(
        self,
        density: AssistDensity | str | os.PathLike[str] | None = None,
        *,
        gamma: float,
        weight: float = 1.0,
        start_weight: float = 100.0,
        keys: Mapping[str, NestedKey | None] | None = None,
    ) -> None:
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active", "game_mode"),
            parts=("reward_potential",),
            memory=("last_ball_position",),
            keys=keys,
        )
        self.density = density_from(density)
        self.gamma = check_number("gamma", gamma, highest=1.0)
        self.weight = check_number("weight", weight)
        self.start_weight = check_number("start_weight", start_weight)

    def potential(self, position: Tensor) -> Tensor:
        """The potential (...) of having the ball somewhere, floating point (..., 2).

        It is at least 0, and 0 outside the pitch.
        """
        start, end = self.density.start(position), self.density.end(position)
        return (start * self.start_weight + end) * self.weight

    def _observe_result(self, following: TensorDictBase, scoring: Tensor) -> Observation:
        observation = super()._observe_result(following, scoring)
        terminated = self._get(following, "terminated")
        observation["terminated"] = terminated.reshape(observation["ball"].shape[:-1])
        return observation

    def _first_memory(self, observation: Observation) -> Memory:
        nowhere = torch.full_like(observation["ball"][..., :2], _NOWHERE)
        return {"last_ball_position": self._position(nowhere, observation)}

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        position = self._position(memory["last_ball_position"], observation)
        ended = observation["terminated"].unsqueeze(-1)
        return {"last_ball_position": position.masked_fill(ended, _NOWHERE)}

    def _position(self, held: Tensor, observation: Observation) -> Tensor:
        control, lost = in_control(observation), ball_lost(observation)
        held = held.masked_fill(lost.unsqueeze(-1), _NOWHERE)
        return torch.where(control.unsqueeze(-1), observation["ball"][..., :2], held)

    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        positions = torch.stack((memory["last_ball_position"], remembered["last_ball_position"]))
        before, after = self.potential(positions).unbind(0)
        return (self.gamma * after - before,)
