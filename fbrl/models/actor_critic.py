"""The actor-critic that PPO trains: one trunk, a policy head and a value head."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torch.distributions import Categorical
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import ActorValueOperator, ProbabilisticActor, ValueOperator

from fbrl.checks.counts import check_count
from fbrl.models.impala import ImpalaCNN
from fbrl.models.mlp import MLP, Activation
from fbrl.transforms.players_table import NUM_FEATURES

__all__ = [
    "OBSERVATION_KEYS",
    "ActorCritic",
    "CollectionPolicy",
    "ObservationName",
    "build_actor_critic",
]

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
        trunk: maps the observation to features.
        observation_key: what the trunk reads.
        num_features: size of the trunk's output.
        num_actions: number of discrete actions.
        device: where the parameters of the heads live.
    """

    def __init__(
        self,
        trunk: nn.Module,
        observation_key: NestedKey,
        num_features: int,
        num_actions: int,
        device: torch.device | str | None = None,
    ) -> None:
        policy_head = _orthogonal_linear(num_features, num_actions, 0.01, device)
        value_head = _orthogonal_linear(num_features, 1, 1.0, device)
        super().__init__(
            TensorDictModule(trunk, in_keys=[observation_key], out_keys=["hidden"]),
            ProbabilisticActor(
                TensorDictModule(policy_head, in_keys=["hidden"], out_keys=["logits"]),
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

    def get_collection_policy(self) -> CollectionPolicy:
        """Returns the policy that acts in the environment; it shares the parameters."""
        trunk = self.get_submodule("module.0.module")
        policy_head = self.get_submodule("module.1.module.0.module")
        value_head = self.get_submodule("module.2.module")
        return CollectionPolicy(trunk, policy_head, value_head, self.module[0].in_keys[0])


class CollectionPolicy(TensorDictModuleBase):
    """Chooses actions, and writes their log-probability and the value of the state.

    The same numbers as the operators of :class:`ActorCritic`, from one call of the trunk, without
    building distributions and without writing ``hidden`` and ``logits``, which a collector would
    store. Nothing it writes requires gradients. The tensordict may be on another device than the
    parameters: only the observation, and what is written, are moved.

    Actions are sampled, or the most probable ones under
    ``torchrl.envs.set_exploration_type(ExplorationType.DETERMINISTIC)``.

    Args:
        trunk: maps the observation to features.
        policy_head: maps the features to logits.
        value_head: maps the features to a value.
        observation_key: what the trunk reads.
    """

    def __init__(
        self,
        trunk: nn.Module,
        policy_head: nn.Linear,
        value_head: nn.Linear,
        observation_key: NestedKey,
    ) -> None:
        super().__init__()
        self.trunk = trunk
        self.policy_head = policy_head
        self.value_head = value_head
        self.in_keys = [observation_key]
        self.out_keys = ["action", "action_log_prob", "state_value"]
        self._pinned: torch.Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds ``action``, ``action_log_prob`` and ``state_value``."""
        return self._act(tensordict, exploration_type() or ExplorationType.RANDOM)

    @torch.no_grad()
    def sample(self, tensordict: TensorDictBase) -> TensorDictBase:
        """As ``forward``, with sampled actions whatever the exploration type.

        All threads have one exploration type, and TorchRL's losses set it: a thread that acts while
        another one learns must not read it.
        """
        return self._act(tensordict, ExplorationType.RANDOM)

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.value_head.weight.device

    def draw_noise(self, num_states: int) -> torch.Tensor:
        """The random numbers that sample an action in so many states, shape (num_states, actions).

        They are what torch.multinomial draws for one draw from each state.
        """
        head = self.policy_head
        return head.weight.new_empty((num_states, head.out_features)).exponential_()

    @torch.no_grad()
    def act(
        self, observation: torch.Tensor, noise: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Chooses actions by tensors alone.

        Args:
            observation: shape (states, ...), on any device.
            noise: from :meth:`draw_noise`; ``None`` for the most probable actions.

        Returns:
            The actions (states,), their log-probabilities (states,) and the values of the states
            (states, 1), on the policy's device.
        """
        hidden = self.trunk(self._on_device(observation))
        logits = self.policy_head(hidden)
        # As torch's Categorical does it, bit for bit, so that PPO's ratio starts at exactly 1.
        log_probs = logits - logits.logsumexp(-1, keepdim=True)
        action = (log_probs if noise is None else log_probs.softmax(-1) / noise).argmax(-1)
        log_prob = log_probs.gather(-1, action.unsqueeze(-1)).squeeze(-1)
        return action, log_prob, self.value_head(hidden)

    def _act(self, tensordict: TensorDictBase, exploration: ExplorationType) -> TensorDictBase:
        observation = tensordict.get(self.in_keys[0], None)
        if observation is None:
            raise KeyError(
                f"The policy reads {self.in_keys[0]!r}, which is not in the tensordict: it has "
                f"{sorted(map(str, tensordict.keys()))}. Give the environment its observation."
            )
        noise = None
        if exploration is ExplorationType.RANDOM:
            noise = self.draw_noise(tensordict.numel()).reshape(*tensordict.shape, -1)
        elif exploration not in (ExplorationType.DETERMINISTIC, ExplorationType.MODE):
            raise ValueError(
                f"The exploration type is {exploration}, but discrete actions have no such value: "
                "set ExplorationType.RANDOM to sample, or DETERMINISTIC for the most probable "
                "action."
            )
        for key, value in zip(self.out_keys, self.act(observation, noise), strict=True):
            tensordict.set(key, value.to(observation.device))
        return tensordict

    def _on_device(self, observation: torch.Tensor) -> torch.Tensor:
        device = self.device
        if observation.device == device or device.type != "cuda":
            return observation.to(device)
        if self._pinned is None or self._pinned.shape != observation.shape:
            self._pinned = torch.empty_like(observation, pin_memory=True)
        # Only from pinned memory the CPU need not wait for the transfer. It waits for the actions,
        # after which the next observation may take this one's place.
        return self._pinned.copy_(observation).to(device, non_blocking=True)


def build_actor_critic(
    observation: ObservationName,
    num_actions: int = 19,
    *,
    num_frames: int = 4,
    hidden_sizes: Sequence[int] = (256, 256),
    activation: Activation = "relu",
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
    num_actions = check_count("num_actions", num_actions)
    trunk: ImpalaCNN | MLP
    if observation in VECTOR_SIZES:
        trunk = MLP(VECTOR_SIZES[observation], hidden_sizes, activation, device)
    else:
        trunk = ImpalaCNN(num_frames, device=device)
    return ActorCritic(
        trunk, OBSERVATION_KEYS[observation], trunk.num_features, num_actions, device
    )


def _orthogonal_linear(
    num_in: int, num_out: int, gain: float, device: torch.device | str | None
) -> nn.Linear:
    linear = nn.Linear(num_in, num_out, device=device)
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.zeros_(linear.bias)
    return linear
