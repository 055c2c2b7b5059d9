"""The actor-critic that PPO trains: one trunk, a policy head and a value head."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.envs.utils import ExplorationType
from torchrl.modules import ActorValueOperator, ProbabilisticActor, ValueOperator

from fbrl.checks.counts import check_count
from fbrl.models.collection_policy import CollectionPolicy
from fbrl.models.impala import ImpalaCNN
from fbrl.models.mirror import MIRRORED_ACTIONS, MIRRORS, MirroredTrunk
from fbrl.models.mlp import MLP, Activation, orthogonal
from fbrl.models.player_set import PlayerSet
from fbrl.models.policy_head import PolicyHead
from fbrl.transforms.players_table import NUM_FEATURES

__all__ = [
    "OBSERVATION_KEYS",
    "ActorCritic",
    "CollectionPolicy",
    "ObservationName",
    "build_actor_critic",
]

NetworkName = Literal["mlp", "player_set"]

ObservationName = Literal["minimap", "smm", "simple115", "players"]

OBSERVATION_KEYS: dict[str, str] = {
    "minimap": "minimap_cells",
    "smm": "smm",
    "simple115": "simple115",
    "players": "players",
}
"""The tensordict key of each observation."""

VECTOR_SIZES: dict[str, int] = {"simple115": 115, "players": NUM_FEATURES}
"""How many numbers there are in those that are vectors."""


class ActorCritic(ActorValueOperator):
    """A trunk that writes ``hidden``, and a policy and a value head that read it.

    For the PPO loss, pass ``get_policy_operator()`` as the actor and ``get_value_head()`` as the
    critic: the actor leaves ``hidden`` for the critic, so the trunk runs once.
    ``get_value_operator()`` computes values on their own, and ``get_collection_policy()`` acts in
    the environment. All of them share their parameters.

    Args:
        trunk: maps the observation to features; a :class:`~fbrl.models.mirror.MirroredTrunk` also
            to whether they are those of the mirrored state, which it writes as ``mirrored``.
        observation_key: what the trunk reads.
        num_features: size of the trunk's output.
        num_actions: number of discrete actions.
        device: where the parameters of the heads live.
        is_masked: whether the policy reads ``action_mask`` and chooses none that is false there.
    """

    def __init__(
        self,
        trunk: nn.Module,
        observation_key: NestedKey,
        num_features: int,
        num_actions: int,
        device: torch.device | str | None = None,
        *,
        is_masked: bool = False,
    ) -> None:
        policy_head = orthogonal(PolicyHead(num_features, num_actions, device), 0.01)
        value_head = orthogonal(nn.Linear(num_features, 1, device=device), 1.0)
        features = ["hidden", "mirrored"] if isinstance(trunk, MirroredTrunk) else ["hidden"]
        read_by_policy = [*features, "action_mask"] if is_masked else features
        super().__init__(
            TensorDictModule(trunk, in_keys=[observation_key], out_keys=features),
            ProbabilisticActor(
                TensorDictModule(
                    policy_head,
                    in_keys={key: key for key in read_by_policy},
                    out_keys=["logits"],
                    out_to_in_map=True,
                ),
                in_keys=["logits"],
                distribution_class=Categorical,
                # Validation reads the logits back, which makes a GPU wait.
                distribution_kwargs={"validate_args": False},
                default_interaction_type=ExplorationType.RANDOM,
                return_log_prob=True,
                log_prob_key="action_log_prob",
            ),
            ValueOperator(value_head, in_keys=["hidden"]),
        )
        self._is_masked = is_masked

    def get_collection_policy(self) -> CollectionPolicy:
        """Returns the policy that acts in the environment; it shares the parameters."""
        trunk = self.get_submodule("module.0.module")
        policy_head = self.get_submodule("module.1.module.0.module")
        value_head = self.get_submodule("module.2.module")
        observation_key = self.module[0].in_keys[0]
        return CollectionPolicy(
            trunk, policy_head, value_head, observation_key, is_masked=self._is_masked
        )


def build_actor_critic(
    observation: ObservationName,
    num_actions: int = 19,
    *,
    num_frames: int = 4,
    hidden_sizes: Sequence[int] = (256, 256),
    activation: Activation = "relu",
    network: NetworkName = "mlp",
    is_mirrored: bool = False,
    is_masked: bool = False,
    device: torch.device | str | None = None,
) -> ActorCritic:
    """Builds the actor-critic for an observation.

    The heads are initialised as in OpenAI's Baselines, from which gfootball's own training runs:
    orthogonal weights of gain 0.01 for the policy and 1 for the value, and biases of zero.

    Args:
        observation: ``"minimap"`` (reads ``minimap_cells``) and ``"smm"`` (reads ``smm``) give
            the same convolutional network, ``"simple115"`` and ``"players"`` a multilayer
            perceptron.
        num_actions: number of discrete actions.
        num_frames: how many frames ``"minimap"`` and ``"smm"`` stack.
        hidden_sizes: sizes of the perceptron's layers.
        activation: of the perceptron, ``"relu"`` or ``"tanh"``.
        network: what reads ``"players"``: ``"mlp"``, or ``"player_set"``, which treats players as
            sets. The other observations have one network each.
        is_mirrored: whether the network sees every state with the ball in the lower half, see
            :mod:`fbrl.models.mirror`.
        is_masked: whether the policy reads ``action_mask``, see
            :class:`~fbrl.transforms.EngineActionMask`.
        device: where the parameters live.

    Raises:
        ValueError: A name is unknown or a size is less than 1.
        TypeError: A size is no integer.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> model = build_actor_critic("simple115")
        >>> policy = model.get_collection_policy()
        >>> batch = policy(TensorDict(simple115=torch.zeros(8, 115), batch_size=[8]))
        >>> batch["action"].shape, batch["action_log_prob"].shape, batch["state_value"].shape
        (torch.Size([8]), torch.Size([8]), torch.Size([8, 1]))
        >>> sum(p.numel() for p in build_actor_critic("minimap").parameters())
        396868
    """
    if observation not in list(OBSERVATION_KEYS):
        raise ValueError(
            f"observation is {observation!r}, but must be one of {tuple(OBSERVATION_KEYS)}."
        )
    if network not in get_args(NetworkName):
        raise ValueError(f"network is {network!r}, but must be one of {get_args(NetworkName)}.")
    if network == "player_set" and observation != "players":
        raise ValueError(
            f"The network player_set reads the observation players, but the observation is "
            f"{observation!r}."
        )
    num_actions = check_count("num_actions", num_actions)
    trunk: ImpalaCNN | MLP | PlayerSet | MirroredTrunk
    if network == "player_set":
        trunk = PlayerSet(hidden_sizes=hidden_sizes, activation=activation, device=device)
    elif observation in VECTOR_SIZES:
        trunk = MLP(VECTOR_SIZES[observation], hidden_sizes, activation, device)
    else:
        trunk = ImpalaCNN(num_frames, device=device)
    num_features = trunk.num_features
    if is_mirrored:
        if num_actions != len(MIRRORED_ACTIONS):
            raise ValueError(
                f"num_actions is {num_actions}, but only gfootball's {len(MIRRORED_ACTIONS)} "
                f"actions can be mirrored."
            )
        trunk = MirroredTrunk(trunk, MIRRORS[observation]().to(device))
    return ActorCritic(
        trunk,
        OBSERVATION_KEYS[observation],
        num_features,
        num_actions,
        device,
        is_masked=is_masked,
    )
