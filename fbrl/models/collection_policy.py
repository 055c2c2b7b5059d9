"""The policy's last layer, and the policy that acts in the environment."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type

from fbrl.models.mirror import MIRRORED_ACTIONS

MASKED_LOGIT = -1e9
"""The logit of a masked action: its probability is exactly 0.

Not minus infinity, with which the entropy's gradient would be no number.
"""


class PolicyHead(nn.Linear):
    """A linear layer from features to the logits of discrete actions.

    With masked logits the usual ``Categorical`` has the probabilities, the entropy and the
    log-probabilities of a categorical distribution over the actions that are left, like
    ``torchrl.modules.MaskedCategorical``, at no further cost.

    Examples:
        >>> import torch
        >>> mask = torch.tensor([True] * 18 + [False])
        >>> logits = PolicyHead(8, 19)(torch.zeros(8), action_mask=mask)
        >>> logits.softmax(-1)[18].item()
        0.0
    """

    mirrored_actions: Tensor

    def __init__(
        self, num_features: int, num_actions: int, device: torch.device | str | None = None
    ) -> None:
        super().__init__(num_features, num_actions, device=device)
        order = torch.tensor(MIRRORED_ACTIONS, device=device)
        self.register_buffer("mirrored_actions", order, persistent=False)

    def forward(
        self, hidden: Tensor, mirrored: Tensor | None = None, action_mask: Tensor | None = None
    ) -> Tensor:
        """Maps (..., num_features) to (..., num_actions).

        Args:
            hidden: the features.
            mirrored: bool (...,), where they are those of the mirrored state: the logits are those
                of the mirrored actions there. Only for gfootball's 19 actions.
            action_mask: bool (..., num_actions), false for an action that must not be chosen. In a
                row without any true one all are equally probable.
        """
        logits = super().forward(hidden)
        if mirrored is not None:
            back = logits.index_select(-1, self.mirrored_actions)
            logits = torch.where(mirrored.unsqueeze(-1), back, logits)
        if action_mask is not None:
            logits = logits.masked_fill(~action_mask, MASKED_LOGIT)
        return logits


class CollectionPolicy(TensorDictModuleBase):
    """Chooses actions, and writes their log-probability and the value of the state.

    The same numbers as the operators of :class:`~fbrl.models.ActorCritic`, whose parts it shares,
    from one call of the trunk, without building distributions and without writing ``hidden`` and
    ``logits``, which a collector would store. Nothing it writes requires gradients. The tensordict
    may be on another device than the parameters: only what is read and written is moved.

    Actions are sampled, or the most probable ones under
    ``torchrl.envs.set_exploration_type(ExplorationType.DETERMINISTIC)``.
    """

    def __init__(
        self,
        trunk: nn.Module,
        policy_head: PolicyHead,
        value_head: nn.Linear,
        observation_key: NestedKey,
        *,
        is_masked: bool = False,
    ) -> None:
        super().__init__()
        self.trunk = trunk
        self.policy_head = policy_head
        self.value_head = value_head
        self.in_keys = [observation_key, "action_mask"] if is_masked else [observation_key]
        self.out_keys = ["action", "action_log_prob", "state_value"]
        self._pinned: dict[str, Tensor] = {}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds ``action``, ``action_log_prob`` and ``state_value``."""
        exploration = exploration_type() or ExplorationType.RANDOM
        if exploration is ExplorationType.RANDOM:
            return self.sample(tensordict)
        if exploration not in (ExplorationType.DETERMINISTIC, ExplorationType.MODE):
            raise ValueError(
                f"The exploration type is {exploration}, but discrete actions have no such value: "
                "set ExplorationType.RANDOM to sample, or DETERMINISTIC for the most probable "
                "action."
            )
        return self._write(tensordict, None)

    def sample(self, tensordict: TensorDictBase) -> TensorDictBase:
        """As ``forward``, with sampled actions whatever the exploration type.

        All threads have one exploration type, and TorchRL's losses set it: a thread that acts while
        another one learns must not read it.
        """
        noise = self.draw_noise(tensordict.numel()).reshape(*tensordict.shape, -1)
        return self._write(tensordict, noise)

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.value_head.weight.device

    def draw_noise(self, num_states: int) -> Tensor:
        """The random numbers that sample an action in so many states, shape (num_states, actions).

        An action is sampled by adding independent Gumbel noise to the logits and taking the largest
        (Gumbel 1954), which asks for no probabilities.
        """
        head = self.policy_head
        return head.weight.new_empty((num_states, head.out_features)).exponential_().log_().neg_()

    def act(
        self, observation: Tensor, noise: Tensor | None, action_mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Chooses actions by tensors alone; to be called under ``torch.no_grad()``.

        Args:
            observation: shape (states, ...), on any device.
            noise: from :meth:`draw_noise`; ``None`` for the most probable actions.
            action_mask: bool (states, actions), on any device, false for what must not be chosen.

        Returns:
            The actions (states,), their log-probabilities (states,) and the values of the states
            (states, 1), on the policy's device.
        """
        features = self.trunk(self._on_device("observation", observation))
        hidden, mirrored = features if isinstance(features, tuple) else (features, None)
        if action_mask is not None:
            action_mask = self._on_device("action_mask", action_mask)
        logits = self.policy_head(hidden, mirrored, action_mask)
        # As torch's Categorical does it, bit for bit, so that PPO's ratio starts at exactly 1.
        log_probs = logits - logits.logsumexp(-1, keepdim=True)
        action = (log_probs if noise is None else log_probs + noise).argmax(-1)
        log_prob = log_probs.gather(-1, action.unsqueeze(-1)).squeeze(-1)
        return action, log_prob, self.value_head(hidden)

    @torch.no_grad()
    def _write(self, tensordict: TensorDictBase, noise: Tensor | None) -> TensorDictBase:
        observation, *masks = (self._read(tensordict, key) for key in self.in_keys)
        for key, value in zip(self.out_keys, self.act(observation, noise, *masks), strict=True):
            tensordict.set(key, value.to(observation.device))
        return tensordict

    @staticmethod
    def _read(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        entry = tensordict.get(key, None)
        if entry is None:
            remedy = "one of fbrl's action masks" if key == "action_mask" else "its observation"
            raise KeyError(
                f"The policy reads {key!r}, which is not in the tensordict: it has "
                f"{sorted(map(str, tensordict.keys()))}. Give the environment {remedy}."
            )
        return entry

    def _on_device(self, name: str, entry: Tensor) -> Tensor:
        device = self.device
        if entry.device == device or device.type != "cuda":
            return entry.to(device)
        pinned = self._pinned.get(name, None)
        if pinned is None or pinned.shape != entry.shape:
            pinned = self._pinned[name] = torch.empty_like(entry, pin_memory=True)
        # Only from pinned memory the CPU need not wait for the transfer. It waits for the actions,
        # after which the next observation may take this one's place.
        return pinned.copy_(entry).to(device, non_blocking=True)
