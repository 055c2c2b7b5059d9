"""What the agent did lately: its last action, its last kick, and how long ago that was."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Bounded

from fbrl.transforms.memory import MemoryTransform
from fbrl.transforms.raw_observation import Keys, check_keys

KICKS = (9, 10, 11, 12)
"""The actions that kick: long pass, high pass, short pass and shot."""

MAX_STEPS_SINCE_KICK = 100
"""The count of steps stops there; it stands there too where no kick has been chosen yet."""

_NONE = -1


class ActionMemory(MemoryTransform):
    """Remember the last action and the last kick of an episode.

    Writes ``action_memory``, int64 of shape ``(*batch, 3)``:

    0. the action of the last step, -1 at an episode's beginning;
    1. the kick that was chosen last (one of :data:`KICKS`), -1 for none yet;
    2. steps that were played since the one in which it was chosen, 0 right after that; at most
       :data:`MAX_STEPS_SINCE_KICK`.

    The engine carries a kick out when the player reaches the ball, for which it waits up to two
    seconds, and no raw observation shows that it waits (``humancontroller.cpp``: ``actionMode``).

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

    memory_spec = Bounded(_NONE, MAX_STEPS_SINCE_KICK, shape=(3,), dtype=torch.int64)

    def __init__(self, in_keys: Keys = None, out_keys: Keys = None) -> None:
        super().__init__(in_keys=in_keys or ["action"], out_keys=out_keys or ["action_memory"])
        check_keys(self, ["action"], ["action_memory"])

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """The memory's key."""
        return tuple(self.out_keys)

    def begin(self, state: TensorDictBase) -> None:
        """Sets the memory of episodes that begin."""
        first = torch.tensor([_NONE, _NONE, MAX_STEPS_SINCE_KICK], device=state.device)
        state.set(self.out_keys[0], first.expand(*state.batch_size, 3))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        _, kick, steps = self._before(tensordict)[0].unbind(-1)
        action = tensordict.get(self.in_keys[0], None)
        if action is None:
            raise KeyError(
                f"ActionMemory found no {self.in_keys[0]!r} in the tensordict that was stepped, "
                f"which has {sorted(map(str, tensordict.keys()))}. A policy writes it."
            )
        is_kick = (action >= KICKS[0]) & (action <= KICKS[-1])
        kick = torch.where(is_kick, action, kick)
        steps = (steps + 1).clamp_(max=MAX_STEPS_SINCE_KICK).masked_fill_(is_kick, 0)
        return next_tensordict.set(self.out_keys[0], torch.stack((action, kick, steps), -1))
