"""What the agent did lately: its last action, its last kick, and how long ago that was."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import Transform

__all__ = ["KICKS", "MAX_STEPS_SINCE_KICK", "ActionMemory"]

KICKS = (9, 10, 11, 12)
"""The actions that kick: long pass, high pass, short pass and shot."""

MAX_STEPS_SINCE_KICK = 100
"""The count of steps stops there; it stands there too where no kick has been chosen yet."""

_NONE = -1


class ActionMemory(Transform):
    """Remember the last action and the last kick of an episode.

    Writes ``action_memory``, int64 of shape ``(*batch, 3)``:

    0. the action of the last step, -1 at an episode's beginning;
    1. the kick that was chosen last (one of :data:`KICKS`), -1 for none yet;
    2. steps that were played since the one in which it was chosen, 0 right after that; at most
       :data:`MAX_STEPS_SINCE_KICK`.

    The engine carries a kick out when the player reaches the ball, for which it waits up to two
    seconds, and no raw observation shows that it waits (``humancontroller.cpp``: ``actionMode``).

    Like a step counter's count the memory lives in the tensordict, so that vectorised and partially
    reset environments work; a step needs what the previous step, or the reset, returned.

    Args:
        in_keys: where to find the action, an index of gfootball's default action set.
        out_keys: where to write the memory.

    Raises:
        ValueError: if there are more or fewer keys than one.

    Examples:
        >>> import torch
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_empty_goal", num_envs=1, observation=ActionMemory())
        >>> state, memories = env.reset(), []
        >>> for action in (12, 5, 5):
        ...     _, state = env.step_and_maybe_reset(state.set("action", torch.tensor([action])))
        ...     memories.append(state["action_memory"].tolist())
        >>> memories
        [[[12, 12, 0]], [[5, 12, 1]], [[5, 12, 2]]]
    """

    def __init__(self, in_keys: list[str] | None = None, out_keys: list[str] | None = None) -> None:
        super().__init__(in_keys=in_keys or ["action"], out_keys=out_keys or ["action_memory"])
        if len(self.in_keys) != 1 or len(self.out_keys) != 1:
            raise ValueError(
                f"ActionMemory: in_keys must name the action's key and out_keys that of the "
                f"memory; got in_keys={self.in_keys} and out_keys={self.out_keys}."
            )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        key = self.out_keys[0]
        first = _first_memory(tensordict_reset)
        mask = tensordict.get("_reset", None)
        kept = tensordict.get(key, None)
        if mask is not None and kept is not None:
            first = torch.where(mask.reshape(kept.shape[:-1]).unsqueeze(-1), first, kept)
        return tensordict_reset.set(key, first)

    _reset_on_native_autoreset = _reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        key = self.out_keys[0]
        memory, action = tensordict.get(key, None), tensordict.get(self.in_keys[0], None)
        if memory is None or action is None:
            missing = key if memory is None else self.in_keys[0]
            raise KeyError(
                f"ActionMemory found no {missing!r} in the tensordict that was stepped, which has "
                f"{sorted(map(str, tensordict.keys()))}. Step what env.reset() or the previous "
                f"step returned, with the action added."
            )
        return next_tensordict.set(key, _remember(memory, action))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Remembered is step by step in an environment; there is nothing to do here."""
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the memory to the observation."""
        observation_spec[self.out_keys[0]] = self._memory_spec(observation_spec)
        return observation_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Adds the memory to the state: each step reads that of the step before."""
        state_spec = input_spec["full_state_spec"]
        input_spec["full_state_spec", self.out_keys[0]] = self._memory_spec(state_spec)
        return input_spec

    @staticmethod
    def _memory_spec(parent: Composite) -> Bounded:
        shape = (*parent.shape, 3)
        return Bounded(
            _NONE, MAX_STEPS_SINCE_KICK, shape=shape, dtype=torch.int64, device=parent.device
        )


def _first_memory(state: TensorDictBase) -> Tensor:
    first = torch.tensor([_NONE, _NONE, MAX_STEPS_SINCE_KICK], device=state.device)
    return first.expand(*state.batch_size, 3)


def _remember(memory: Tensor, action: Tensor) -> Tensor:
    _, kick, steps = memory.unbind(-1)
    is_kick = (action >= KICKS[0]) & (action <= KICKS[-1])
    kick = torch.where(is_kick, action, kick)
    steps = (steps + 1).clamp_(max=MAX_STEPS_SINCE_KICK).masked_fill_(is_kick, 0)
    return torch.stack((action, kick, steps), -1)
