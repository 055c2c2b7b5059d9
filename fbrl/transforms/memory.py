"""What depends on the steps before, worked out for a whole batch of ordered steps."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict.utils import expand_as_right
from torch import Tensor

__all__ = [
    "Memory",
    "latest_before_steps",
    "memory_before_steps",
    "totals_after_steps",
    "unbind",
    "where",
]

Memory = dict[str, Tensor]
"""What is remembered of an episode, by its usual names; each begins with the match's shape."""


def memory_before_steps(
    first: Memory, ended: Tensor, remember: Callable[[int, Memory], Memory], time: int
) -> Memory:
    """The memory before each step.

    Args:
        first: the memory before each step if an episode began with it; that of the very first step
            is taken as it is.
        ended: boolean, whether an episode ended with each step.
        remember: given the number of a step and the memory before it, returns the memory after it.
        time: dimension along which the steps follow each other.

    Examples:
        >>> import torch
        >>> first, ended = {"count": torch.zeros(1, 4)}, torch.tensor([[False, False, True, False]])
        >>> def count(step, memory):
        ...     return {"count": memory["count"] + 1}
        >>> memory_before_steps(first, ended, count, time=1)
        {'count': tensor([[0., 1., 2., 0.]])}
    """
    firsts, ends = unbind(first, time), ended.unbind(time)
    memories = [firsts[0]]
    for step in range(len(firsts) - 1):
        remembered = remember(step, memories[-1])
        memories.append(where(ends[step], firsts[step + 1], remembered))
    return {name: torch.stack([memory[name] for memory in memories], time) for name in first}


def latest_before_steps(
    first: Tensor, ended: Tensor, value: Tensor, changes: Tensor, time: int
) -> Tensor:
    """What some steps change and others leave, before each step: all steps at once.

    Args:
        first: what it is before each step if an episode began with it; that of the very first step
            is taken as it is.
        ended: boolean, whether an episode ended with each step.
        value: what it is after a step that changes it.
        changes: boolean, which steps do.
        time: dimension along which the steps follow each other.

    Examples:
        >>> import torch
        >>> ended = torch.tensor([False, False, False, True, False])
        >>> changes = torch.tensor([False, True, False, False, True])
        >>> latest_before_steps(torch.zeros(5), ended, torch.arange(5.0), changes, time=0)
        tensor([0., 0., 1., 1., 0.])
    """
    begins = torch.ones_like(ended)
    length = ended.shape[time]
    begins.narrow(time, 1, length - 1).copy_(ended.narrow(time, 0, length - 1))
    known, values = begins.clone(), first.clone()
    known.narrow(time, 1, length - 1).logical_or_(changes.narrow(time, 0, length - 1))
    values.narrow(time, 1, length - 1).copy_(value.narrow(time, 0, length - 1))
    values = torch.where(begins, first, values)
    steps = torch.arange(length, device=ended.device)
    steps = steps.reshape([-1 if d == time % ended.ndim else 1 for d in range(ended.ndim)])
    return values.gather(time, torch.where(known, steps, 0).cummax(time).values)


def where(mask: Tensor, chosen: Memory, other: Memory) -> Memory:
    """Takes from ``chosen`` where the mask is true, and from ``other`` elsewhere."""
    return {
        name: torch.where(expand_as_right(mask, value), value, other[name])
        for name, value in chosen.items()
    }


def unbind(entries: dict[str, Tensor], dimension: int) -> list[dict[str, Tensor]]:
    """Takes entries apart along a dimension that all of them have."""
    columns = [value.unbind(dimension) for value in entries.values()]
    return [dict(zip(entries, column, strict=True)) for column in zip(*columns, strict=True)]


def totals_after_steps(start: Tensor, amounts: Tensor, ended: Tensor) -> Tensor:
    """Sums since each episode's beginning, added up in the order of the steps.

    Args:
        start: the totals before the first step, shape (num_envs, amounts).
        amounts: what each step adds, shape (num_envs, num_steps, amounts).
        ended: boolean, whether an episode ended with each step, shape (num_envs, num_steps).

    Returns:
        The totals after each step, shape (num_envs, num_steps, amounts); those of an episode's
        last step are the whole episode's.

    Examples:
        >>> import torch
        >>> ended = torch.tensor([[False, True, False]])
        >>> totals_after_steps(torch.tensor([[5.0]]), torch.ones(1, 3, 1), ended).flatten()
        tensor([6., 7., 1.])
    """
    totals, total = [], start
    for amount, end in zip(amounts.unbind(1), ended.unsqueeze(-1).unbind(1), strict=True):
        totals.append(total + amount)
        total = totals[-1].masked_fill(end, 0)
    return torch.stack(totals, 1)
