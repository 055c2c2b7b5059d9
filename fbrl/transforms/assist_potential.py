"""The potential-based sibling of the assist reward, which leaves the best policy as it is."""

from __future__ import annotations

import os
from collections.abc import Mapping

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from fbrl.density import AssistDensity
from fbrl.transforms.ball_control import Observation, ball_lost, in_control
from fbrl.transforms.memory import Memory
from fbrl.transforms.reward_arguments import check_number, density_from
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

    The thesis's reward adds the start density up over the steps with the ball and pays the end
    density once for each pass. A potential is a level, to which either contributes once; with the
    default :math:`c = 100` both have the peak 0.1, and for the shipped pair the potential is at
    most 0.155.

    Along an episode of T steps the payments telescope,
    :math:`\sum_t \gamma^t F_t = \gamma^T \Phi(s_T) - \Phi(s_0)`, whatever is done in it. With
    :math:`\Phi(s_T) = 0` the discounted return of every policy is changed by
    :math:`-\Phi(s_0)`, which depends on the start alone. So the order of the policies, and the best
    one, stay as they are for the scoring reward (Ng, Harada and Russell 1999, "Policy invariance
    under reward transformations"), also for policies that don't see what is remembered. Holding the
    ball, or passing it to and fro, earns nothing in sum; a higher ``weight`` can't change that.

    At a time limit (``truncated``, not ``terminated``) the potential is not made 0. There PPO goes
    on with :math:`\gamma V'(s_T)`, and the value that belongs to this reward is the scoring
    reward's minus the potential, :math:`V' = V - \Phi`: with the payment :math:`\gamma \Phi(s_T)`
    it makes the scoring reward's :math:`\gamma V(s_T)` again. With 0, having the ball when the time
    is over would be punished. Whoever takes time limits for ends, without a value after them,
    passes ``keys={"terminated": "done"}``.

    Summed without discount, as episodes are logged, the payments are
    :math:`\Phi(s_T) - \Phi(s_0) - (1 - \gamma) \sum_{t=1}^{T} \Phi(s_t)`: mostly a little below 0.

    Entries are those of :class:`~fbrl.transforms.AssistDensityReward`, but for these. Read under
    ``"next"`` as well:

    - ``terminated`` (..., 1) boolean. TorchRL's environments have it; of stored data that only has
      ``done``, pass ``keys={"terminated": "done"}`` if no time limit cut the episodes off.

    Written instead of the parts there:

    - ``reward_potential`` (..., 1) float32: the payment.
    - ``last_ball_position`` (..., 2), the ball's dtype: b, or (-2, -2) where the potential is 0.
      Also at the root: before the action. It is the same whatever the densities, weights and gamma,
      so that stored data can be relabelled with others.

    Args:
        density: as for :class:`~fbrl.transforms.AssistDensityReward`.
        gamma: the discount that the agent is trained with, 0 to 1. With another one the payments
            don't telescope, and the best policy may change.
        weight: factor of the potential, at least 0.
        start_weight: factor of the start density within the potential, at least 0.
        keys: other names for these entries, by their usual name; ``None`` for an integer that the
            environment lacks, which is then 0.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from fbrl.transforms import AssistDensityPotential
        >>> flying = {"ball": torch.tensor([0.7, 0.0, 1.0]), "ball_owned_team": torch.tensor(-1),
        ...           "ball_owned_player": torch.tensor(-1), "active": torch.tensor(9),
        ...           "game_mode": torch.tensor(0)}
        >>> received = {"ball": torch.tensor([0.86, 0.0, 0.0]), "ball_owned_team": torch.tensor(0),
        ...             "ball_owned_player": torch.tensor(9), "active": torch.tensor(9),
        ...             "game_mode": torch.tensor(0)}
        >>> ongoing = {"reward": torch.zeros(1), "terminated": torch.tensor([False])}
        >>> reward = AssistDensityPotential(gamma=0.993)
        >>> step = TensorDict({"last_ball_position": torch.tensor([0.4, 0.1]),
        ...                    "next": {**flying, **ongoing}})
        >>> step = reward(step)
        >>> print(f"{step['next', 'reward'].item():.4f}")  # held, but for the discount
        -0.0004
        >>> step = TensorDict({"last_ball_position": step["next", "last_ball_position"],
        ...                    "next": {**received, **ongoing}})
        >>> print(f"{reward(step)['next', 'reward'].item():.4f}")
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
        """The potential of having the ball somewhere.

        Args:
            position: (..., 2) floating-point x and y on the pitch.

        Returns:
            Shape (...), at least 0; 0 outside the pitch.
        """
        start, end = self.density.start(position), self.density.end(position)
        return (start * self.start_weight + end) * self.weight

    def _observe_result(self, following: TensorDictBase, where: str) -> Observation:
        observation = self._observe(following, where)
        terminated = self._get(following, "terminated", where)
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
