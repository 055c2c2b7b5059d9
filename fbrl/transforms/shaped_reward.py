"""Rewards that add shaping to scoring and remember something of the episode so far."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.utils import expand_as_right
from torch import Tensor

from fbrl.transforms.ball_control import Observation
from fbrl.transforms.memory import Memory, MemoryTransform, memory_before_steps, unbind
from fbrl.transforms.raw_observation import FIELD_SHAPES, checked_field
from fbrl.transforms.scoring_reward import ScoringReward


class ShapedReward(MemoryTransform, ScoringReward):
    """Base of the rewards ``reward = reward_scoring + parts``, with a memory.

    The memory lives in the tensordict, not in the module: the root entries are the memory before
    the action, those under ``"next"`` the memory after it. So single, batched, vectorised and
    partially reset environments, collectors and stored data all work alike.

    A subclass says what is remembered (:meth:`_first_memory`, :meth:`_remember`) and what is paid
    for it (:meth:`_pay`).

    Args:
        observations: usual names of the observation entries that are read: ``ball``, and whatever
            else of :mod:`fbrl.envs.observation`. Single integers may have any other name, too.
        parts: usual names of the parts besides ``reward_scoring``.
        memory: usual names of the memory's entries.
        keys: other names for these entries, see :class:`~fbrl.transforms.ScoringReward`. A single
            integer whose key is ``None`` is 0 throughout.
    """

    _stored_memory_is_valid = True
    """False where the memory depends on what has been paid: another reward has paid otherwise."""

    def __init__(
        self,
        *,
        observations: Sequence[str],
        parts: Sequence[str],
        memory: Sequence[str],
        keys: Mapping[str, NestedKey | None] | None = None,
    ) -> None:
        integers = [name for name in observations if not FIELD_SHAPES.get(name)]
        self._set_keys(observations, [*parts, *memory], keys, optional=integers)
        self._observations = tuple(observations)
        self._parts = tuple(parts)
        self._memory = tuple(memory)

    @property
    def part_names(self) -> tuple[str, ...]:
        """The usual names of the parts that ``reward`` is the sum of."""
        return ("reward_scoring", *self._parts)

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """The keys of the memory."""
        return tuple(self._keys[name] for name in self._memory)

    @abstractmethod
    def _first_memory(self, observation: Observation) -> Memory:
        """Return the memory at the start of an episode."""

    @abstractmethod
    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        """Return the memory after a step that led to this observation and scoring reward."""

    @abstractmethod
    def _pay(
        self, memory: Memory, remembered: Memory, observation: Observation
    ) -> tuple[Tensor, ...]:
        """Return the parts, each of shape (...), for a step between these two memories."""

    def _advance(
        self, memory: Memory, observation: Observation, scoring: Tensor
    ) -> tuple[Memory, tuple[Tensor, ...]]:
        """Return the memory after a step, and the parts that the step earns."""
        remembered = self._remember(memory, observation, scoring)
        return remembered, self._pay(memory, remembered, observation)

    def begin(self, state: TensorDictBase) -> None:
        """Sets the memory of episodes that begin with these observations."""
        observation = self._observe(state, "the environment's observations")
        self._set_memory(state, self._first_memory(observation))

    def _set_memory(self, tensordict: TensorDictBase, memory: Memory) -> None:
        for name, value in memory.items():
            tensordict.set(self._keys[name], value)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory = dict(zip(self._memory, self._before(tensordict), strict=True))
        # Never a `reward_scoring` left over from an earlier step of the same tensordict.
        scoring = self._get(next_tensordict, "reward")
        observation = self._observe_result(next_tensordict, scoring)
        self._write(next_tensordict, memory, observation, scoring)
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Relabel stored transitions; doing it twice changes nothing.

        The scoring reward is ``reward_scoring`` where it is present, else ``reward``. The memory
        is read from the root; where it is absent, or depends on the reward, it is worked out along
        the time dimension: the one named ``"time"``, else the last batch dimension. Such data must
        hold whole, ordered steps; a stored window that begins in the middle of an episode starts
        with the memory of an episode that begins there.

        Args:
            tensordict: transitions with the observation at their root and under ``"next"``.

        Raises:
            KeyError: if an entry is missing.
            TypeError: if an entry is of another dtype.
            ValueError: if an entry has another shape, or the steps do not follow each other.
        """
        following = self._following(tensordict)
        scoring = self._stored_scoring(following)
        observation = self._observe_result(following, scoring)
        stored = {name: tensordict.get(self._keys[name], None) for name in self._memory}
        memory = {name: value for name, value in stored.items() if value is not None}
        if len(memory) < len(stored) or not self._stored_memory_is_valid:
            memory = self._recall(tensordict, following, observation, scoring)
            self._set_memory(tensordict, memory)
        self._write(following, memory, observation, scoring)
        return tensordict

    def label(self, batch: TensorDictBase, start: TensorDictBase, end: TensorDictBase) -> None:
        """See :meth:`ScoringReward.label`."""
        following = self._following(batch)
        scoring = self._get(following, "reward")
        observation = self._observe_result(following, scoring)
        first = self._first_memory(self._observe(batch, "the root"))
        for name, value in first.items():
            # A copy: what begins may be an entry of the batch as it is.
            first[name] = value = value.clone()
            value[:, 0] = self._get(start, name, "what the batch began with")
        done = self._get(following, "done").reshape(observation["ball"].shape[:-1])
        memory = self._memory_before(first, observation, scoring, done, time=1)
        self._write(following, memory, observation, scoring)
        self._set_memory(batch, memory)
        self.begin(end)
        for key in self.memory_keys:
            remembered = following.get(key)[:, -1]
            ended = expand_as_right(done[:, -1], remembered)
            end.set(key, torch.where(ended, end.get(key), remembered))

    def _write(
        self, following: TensorDictBase, memory: Memory, observation: Observation, scoring: Tensor
    ) -> None:
        """Set the reward, its parts and the memory after steps with this memory before them."""
        shape = observation["ball"].shape[:-1]
        for name, value in memory.items():
            if value.shape[: len(shape)] != shape:
                raise ValueError(
                    f"{self._keys[name]!r} has shape {tuple(value.shape)}; expected "
                    f"{tuple(shape)}, as {type(self).__name__} writes it."
                )
        remembered, parts = self._advance(memory, observation, scoring.squeeze(-1))
        reward = scoring
        for name, part in zip(self._parts, parts, strict=True):
            paid = part.to(torch.float32).unsqueeze(-1)
            following.set(self._keys[name], paid)
            reward = reward + paid
        following.set(self._keys["reward_scoring"], scoring)
        following.set(self._keys["reward"], reward)
        self._set_memory(following, remembered)

    def _observe(self, tensordict: TensorDictBase, where: str) -> Observation:
        ball = self._get(tensordict, "ball", where)
        if not ball.is_floating_point() or ball.ndim == 0 or ball.shape[-1] < 2:
            raise TypeError(
                f"{self._keys['ball']!r} in {where} is {ball.dtype} of shape {tuple(ball.shape)}; "
                "expected floating point of shape (..., 2 or more): x and y on the pitch first."
            )
        shape, reader = ball.shape[:-1], f"{type(self).__name__} in {where}"
        observation = {"ball": ball}
        for name in self._observations:
            key = self._keys.get(name)
            if key is None:
                observation[name] = ball.new_zeros(shape, dtype=torch.int64)
            elif name != "ball":
                value = checked_field(self._get(tensordict, name, where), name, shape, key, reader)
                observation[name] = value if value.is_floating_point() else value.long()
        return observation

    def _observe_result(self, following: TensorDictBase, scoring: Tensor) -> Observation:
        """Read what a step led to, besides its scoring reward."""
        observation = self._observe(following, "'next'")
        ball = observation["ball"]
        if scoring.shape != (*ball.shape[:-1], 1):
            raise ValueError(
                f"{self._keys['reward']!r} has shape {tuple(scoring.shape)}, but "
                f"{self._keys['ball']!r} has {tuple(ball.shape)}; expected a reward of shape "
                f"{(*ball.shape[:-1], 1)}."
            )
        return observation

    def _recall(
        self,
        tensordict: TensorDictBase,
        following: TensorDictBase,
        observation: Observation,
        scoring: Tensor,
    ) -> Memory:
        """Work out the memory before each step of stored, ordered steps."""
        without, store = "With a memory that depends on the reward", ""
        if self._stored_memory_is_valid:
            without = f"Without {' and '.join(map(repr, self.memory_keys))}"
            store = "Store it with the data. Or: "
        if not tensordict.batch_dims:
            raise KeyError(
                f"{without}, a single transition cannot be relabelled: the reward depends on the "
                f"episode so far. {store}Pass a whole trajectory."
            )
        names = tensordict.names
        time = names.index("time") if "time" in names else tensordict.batch_dims - 1
        before = self._observe(tensordict, "the root")
        first = self._first_memory(before)
        shape = before["ball"].shape[:-1]
        if not shape[time]:
            return first
        done = self._get(following, "done").reshape(shape)
        for name in self._observations:
            if not _follow_each_other(before[name], observation[name], done, time):
                raise ValueError(
                    f"{without}, {type(self).__name__} needs consecutive steps along "
                    f"batch dimension {time}, but {self._keys[name]!r} of some step is not what "
                    f"the step before led to. {store}Relabel the trajectory before shuffling it, "
                    "or name its time dimension 'time'. With a SliceSampler, call this transform "
                    "on what it returns."
                )
        return self._memory_before(first, observation, scoring, done, time)

    def _memory_before(
        self, first: Memory, observation: Observation, scoring: Tensor, done: Tensor, time: int
    ) -> Memory:
        """Work out the memory before ordered steps, see :func:`memory_before_steps`."""
        steps = unbind(observation, time)
        scorings = scoring.squeeze(-1).unbind(time)

        def remember(step: int, memory: Memory) -> Memory:
            if self._stored_memory_is_valid:
                return self._remember(memory, steps[step], scorings[step])
            return self._advance(memory, steps[step], scorings[step])[0]

        return memory_before_steps(first, done, remember, time)


def _follow_each_other(before: Tensor, after: Tensor, done: Tensor, time: int) -> bool:
    """Whether each step begins with what the one before led to, unless an episode ended there."""
    pairs = done.shape[time] - 1
    reached, left = after.narrow(time, 0, pairs), before.narrow(time, 1, pairs)
    same = (reached == left) | ((reached != reached) & (left != left))
    if same.ndim > done.ndim:
        same = same.flatten(done.ndim).all(-1)
    return bool((same | done.narrow(time, 0, pairs)).all())
