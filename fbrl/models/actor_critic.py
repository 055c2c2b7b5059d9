"""The actor-critic that PPO trains: one trunk, a policy head and a value head."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.data import TensorSpec
from torchrl.envs import Transform
from torchrl.envs.utils import ExplorationType
from torchrl.modules import ActorValueOperator, ProbabilisticActor, ValueOperator

from fbrl.checks import check_count
from fbrl.components import NETWORKS
from fbrl.envs.factory import make_observation, observed_key, observed_spec
from fbrl.models.collection_policy import CollectionPolicy, PolicyHead
from fbrl.models.mirror import MIRRORED_ACTIONS, MIRRORS, MirroredTrunk
from fbrl.models.mlp import orthogonal

__all__ = ["ActorCritic", "CollectionPolicy", "build_actor_critic"]


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
        num_features: size of its output.
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
        return CollectionPolicy(
            trunk=self.get_submodule("module.0.module"),
            policy_head=self.get_submodule("module.1.module.0.module"),
            value_head=self.get_submodule("module.2.module"),
            observation_key=self.module[0].in_keys[0],
            is_masked=self._is_masked,
        )


def build_actor_critic(
    observation: str | Transform = "simple115",
    network: str | None = None,
    *,
    num_actions: int = 19,
    is_mirrored: bool = False,
    is_masked: bool = False,
    device: torch.device | str | None = None,
    **options: Any,
) -> ActorCritic:
    """Builds the actor-critic for an observation.

    The heads are initialised as in OpenAI's Baselines, from which gfootball's own training runs:
    orthogonal weights of gain 0.01 for the policy and 1 for the value, and biases of zero.

    Args:
        observation: what is read, as for :func:`fbrl.envs.make_env`.
        network: a name in :data:`fbrl.components.NETWORKS`; by default ``"mlp"`` for vectors and
            ``"impala"`` for all else.
        num_actions: number of discrete actions.
        is_mirrored: whether the network sees every state with the ball in the lower half, see
            :mod:`fbrl.models.mirror`.
        is_masked: whether the policy reads ``action_mask``, see
            :class:`~fbrl.transforms.EngineActionMask`.
        device: where the parameters live.
        options: of the network.

    Raises:
        UnknownNameError: there is no such observation or network.
        ValueError: an option is unknown or out of range, or the network can't read the observation.
        TypeError: a size is no integer.

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
    num_actions = check_count("num_actions", num_actions)
    transform = make_observation(observation)
    key, spec = observed_key(transform), observed_spec(transform)
    if network is None:
        network = "mlp" if len(spec.shape) == 1 else "impala"
    with torch.device(device or "cpu"):
        trunk = NETWORKS.make(network, options, spec.shape)
        num_features = getattr(trunk, "num_features", None) or _size_of_features(trunk, spec)
        if is_mirrored:
            if key not in MIRRORS:
                raise ValueError(f"The observation {key!r} has no mirror in fbrl.models.mirror.")
            if num_actions != len(MIRRORED_ACTIONS):
                raise ValueError(
                    f"num_actions is {num_actions}, but only gfootball's {len(MIRRORED_ACTIONS)} "
                    "actions can be mirrored."
                )
            trunk = MirroredTrunk(trunk, MIRRORS[key]())
    return ActorCritic(trunk, key, num_features, num_actions, device, is_masked=is_masked)


@torch.no_grad()
def _size_of_features(network: nn.Module, spec: TensorSpec) -> int:
    features = network(spec.zero().unsqueeze(0))
    if features.ndim != 2:
        raise ValueError(
            f"The network {type(network).__name__} makes {tuple(features.shape)} of an observation "
            f"of shape {(1, *spec.shape)}; it must make features of shape (1, number)."
        )
    return int(features.shape[-1])
