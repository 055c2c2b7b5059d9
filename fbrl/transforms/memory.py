"""What is remembered of an episode, step by step and for a whole batch of ordered steps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.utils import expand_as_right
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

from fbrl.transforms.raw_observation import zeros_of

Memory = dict[str, Tensor]
"""What is remembered of an episode, by its usual names; each begins with the match's shape."""


class MemoryTransform(Transform):
    """Base of the transforms that remember something of an episode.

    The memory lives in the tensordict, as :class:`~torchrl.envs.StepCounter`'s count does: the
    root entries are the memory before the action, those under ``"next"`` the memory after it. The
    module holds no state, so single, batched, vectorised and partially reset environments,
    collectors and stored data all work alike.
    """

    memory_spec: Bounded | None = None
    """Of what one match remembers under each key, where it is the same whatever is observed."""

    @property
    @abstractmethod
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """The keys of the memory."""

    @abstractmethod
    def begin(self, state: TensorDictBase) -> None:
        """Sets the memory of episodes that begin with these observations."""

    def _before(self, tensordict: TensorDictBase) -> list[Tensor]:
        """The memory before a step, in the order of the keys."""
        memory = []
        for key in self.memory_keys:
            entry = tensordict.get(key, None)
            if entry is None:
                raise KeyError(
                    f"{type(self).__name__} found no {key!r} in the tensordict that was stepped, "
                    f"which has {sorted(map(str, tensordict.keys()))}. "
                    "Step what env.reset() or step_mdp() of the previous step returned, with that "
                    "entry kept."
                )
            memory.append(entry)
        return memory

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Remembered is step by step in an environment; there is nothing to do here."""
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        # Read before anything is written, since both may be the same tensordict.
        memory = {key: tensordict.get(key, None) for key in self.memory_keys}
        self.begin(tensordict_reset)
        for key, kept in memory.items():
            if mask is not None and kept is not None:
                is_reset = expand_as_right(mask.squeeze(-1), kept)
                tensordict_reset.set(key, torch.where(is_reset, tensordict_reset.get(key), kept))
        return tensordict_reset

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._reset(tensordict, tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the memory to the observation."""
        for key, spec in self._memory_specs(observation_spec).items():
            observation_spec[key] = spec
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Adds the memory to what a step needs, so that batched environments hand it on."""
        # TorchRL finds no parent within a Compose in a Compose: where nothing observed decides on
        # the spec it does without.
        around = self.parent.full_observation_spec if self.memory_spec is None else state_spec
        for key, spec in self._memory_specs(around).items():
            state_spec[key] = spec
        return state_spec

    def _memory_specs(self, around: Composite) -> dict[NestedKey, TensorSpec]:
        if self.memory_spec is not None:
            spec = self.memory_spec.expand(*around.shape, *self.memory_spec.shape)
            spec = spec if around.device is None else spec.to(around.device)
            return dict.fromkeys(self.memory_keys, spec)
        first = zeros_of(around, self.in_keys)
        self.begin(first)
        return {
            key: Unbounded(shape=value.shape, dtype=value.dtype, device=value.device)
            for key, value in ((key, first.get(key)) for key in self.memory_keys)
        }


def memory_before_steps(
    first: Memory, ended: Tensor, remember: Callable[[int, Memory], Memory], time: int
) -> Memory:
    """The memory before each step, step by step.

    Args:
        first: the memory before each step if an episode began with it; that of the very first step
            is taken as it is.
        ended: boolean, whether an episode ended with each step.
        remember: given the number of a step and the memory before it, returns the memory after it.
        time: dimension along which the steps follow each other.
    """
    firsts, ends = unbind(first, time), ended.unbind(time)
    memories = [firsts[0]]
    for step, begun in enumerate(firsts[1:]):
        memory = dict(remember(step, memories[-1]))
        for name, value in begun.items():
            memory[name] = torch.where(expand_as_right(ends[step], value), value, memory[name])
        memories.append(memory)
    return {name: torch.stack([memory[name] for memory in memories], time) for name in first}


def latest_before_steps(
    first: Tensor, ended: Tensor, value: Tensor, changes: Tensor, time: int
) -> Tensor:
    """The memory before each step of what only some steps change, for all steps at once.

    Args:
        first: as for :func:`memory_before_steps`.
        ended: likewise.
        value: what a step that changes it makes of it.
        changes: boolean, which steps do.
        time: dimension along which the steps follow each other.
    """
    first, ended, value, changes = (t.movedim(time, 0) for t in (first, ended, value, changes))
    begins = torch.cat([torch.ones_like(ended[:1]), ended[:-1]])
    known = begins | torch.cat([begins[:1], changes[:-1]])
    values = torch.where(begins, first, torch.cat([first[:1], value[:-1]]))
    steps = torch.arange(len(ended), device=ended.device).reshape(-1, *[1] * (ended.ndim - 1))
    latest = torch.where(known, steps, 0).cummax(0).values
    return values.gather(0, latest).movedim(0, time)


def unbind(entries: dict[str, Tensor], dimension: int) -> list[dict[str, Tensor]]:
    """Takes entries apart along a dimension that all of them have."""
    columns = [value.unbind(dimension) for value in entries.values()]
    return [dict(zip(entries, column, strict=True)) for column in zip(*columns, strict=True)]


def totals_after_steps(start: Tensor, amounts: Tensor, ended: Tensor) -> Tensor:
    """Sums since each episode's beginning, after each step (num_envs, num_steps, amounts).

    Those after an episode's last step are the whole episode's.

    Args:
        start: the totals before the first step, shape (num_envs, amounts).
        amounts: what each step adds, shape (num_envs, num_steps, amounts).
        ended: boolean, whether an episode ended with each step, shape (num_envs, num_steps).
    """
    totals, total = [], start
    for amount, end in zip(amounts.unbind(1), ended.unsqueeze(-1).unbind(1), strict=True):
        totals.append(total + amount)
        total = totals[-1].masked_fill(end, 0)
    return torch.stack(totals, 1)
