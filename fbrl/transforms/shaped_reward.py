"""Rewards that add shaping to scoring and remember something of the episode so far."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.utils import expand_as_right
from torch import Tensor
from torchrl.data import Composite, Unbounded

from fbrl.transforms.ball_control import Observation
from fbrl.transforms.memory import Memory, memory_before_steps, unbind, where
from fbrl.transforms.raw_observation import FIELD_SHAPES, FLOAT_FIELDS
from fbrl.transforms.scoring_reward import ScoringReward


class ShapedReward(ScoringReward):
    """Base of the rewards ``reward = reward_scoring + parts``, with a memory.

    The memory lives in the tensordict, as :class:`~torchrl.envs.StepCounter`'s count does: the
    root entries are the memory before the action, those under ``"next"`` the memory after it. The
    module holds no state, so single, batched, vectorised and partially reset environments,
    collectors and stored data all work alike.

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
    """Whether data that another reward of this class has written can be relabelled one by one.

    Not where the memory depends on what that one has paid.
    """

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

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        observation = self._observe(tensordict_reset, "the reset's result")
        memory = self._first_memory(observation)
        kept = self._stored_memory(tensordict)
        reset = tensordict.get("_reset", None)
        if kept is not None and reset is not None:
            memory = where(reset.reshape(observation["ball"].shape[:-1]), memory, kept)
        for name, value in memory.items():
            tensordict_reset.set(self._keys[name], value)
        return tensordict_reset

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._reset(tensordict, tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory = self._stored_memory(tensordict)
        if memory is None:
            missing = [
                self._keys[name]
                for name in self._memory
                if tensordict.get(self._keys[name], None) is None
            ]
            raise KeyError(
                f"{type(self).__name__} found no {missing[0]!r} in the tensordict "
                "that was stepped. Step what env.reset() or the previous step returned, with that "
                "entry kept."
            )
        # Never a `reward_scoring` left over from an earlier step of the same tensordict.
        scoring = self._get(next_tensordict, "reward", "the step's result")
        observation = self._observe_result(next_tensordict, "the step's result")
        self._check_shapes(scoring, observation)
        self._check_memory(memory, observation)
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

        Returns:
            The same tensordict, with the reward, its parts and the memory set anew.

        Raises:
            KeyError: if an entry is missing.
            TypeError: if an entry is of another dtype.
            ValueError: if an entry has another shape, or the memory has to be worked out and the
                steps do not follow each other.
        """
        following = self._following(tensordict)
        scoring = self._stored_scoring(following)
        observation = self._observe_result(following, "'next'")
        self._check_shapes(scoring, observation)
        memory = self._stored_memory(tensordict) if self._stored_memory_is_valid else None
        if memory is None:
            memory = self._recall(tensordict, following, observation, scoring)
            for name, value in memory.items():
                tensordict.set(self._keys[name], value)
        self._check_memory(memory, observation)
        self._write(following, memory, observation, scoring)
        return tensordict

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """The keys of the memory."""
        return tuple(self._keys[name] for name in self._memory)

    def begin(self, state: TensorDictBase) -> None:
        """Sets the memory of episodes that begin with these observations."""
        for name, value in self._first_memory(self._observe(state, "the state")).items():
            state.set(self._keys[name], value)

    def label(self, batch: TensorDictBase, start: TensorDictBase, end: TensorDictBase) -> None:
        """See :meth:`ScoringReward.label`."""
        following = self._following(batch)
        scoring = self._get(following, "reward", "'next'")
        observation = self._observe_result(following, "'next'")
        self._check_shapes(scoring, observation)
        first = self._first_memory(self._observe(batch, "the root"))
        for name, value in first.items():
            # A copy: what begins may be an entry of the batch as it is.
            first[name] = value = value.clone()
            value[:, 0] = self._get(start, name, "what the batch began with")
        done = self._get(following, "done", "'next'").reshape(observation["ball"].shape[:-1])
        memory = self._memory_before(first, observation, scoring, done, time=1)
        self._write(following, memory, observation, scoring)
        self.begin(end)
        for name, value in memory.items():
            key = self._keys[name]
            batch.set(key, value)
            remembered = following.get(key)[:, -1]
            ended = expand_as_right(done[:, -1], remembered)
            end.set(key, torch.where(ended, end.get(key), remembered))

    def _stored_memory(self, tensordict: TensorDictBase) -> Memory | None:
        """Return the memory at the root, ``None`` where an entry of it is missing."""
        memory = {name: tensordict.get(self._keys[name], None) for name in self._memory}
        return None if any(value is None for value in memory.values()) else memory

    def _write(
        self, following: TensorDictBase, memory: Memory, observation: Observation, scoring: Tensor
    ) -> None:
        remembered, parts = self._advance(memory, observation, scoring.squeeze(-1))
        reward = scoring
        for name, part in zip(self._parts, parts, strict=True):
            paid = part.to(torch.float32).unsqueeze(-1)
            following.set(self._keys[name], paid)
            reward = reward + paid
        following.set(self._keys["reward_scoring"], scoring)
        following.set(self._keys["reward"], reward)
        for name, value in remembered.items():
            following.set(self._keys[name], value)

    def _check_shapes(self, scoring: Tensor, observation: Observation) -> None:
        shape = observation["ball"].shape[:-1]
        if scoring.shape != (*shape, 1):
            raise ValueError(
                f"{self._keys['reward']!r} has shape {tuple(scoring.shape)}, but "
                f"{self._keys['ball']!r} has {tuple(observation['ball'].shape)}; expected a reward "
                f"of shape {(*shape, 1)}."
            )

    def _check_memory(self, memory: Memory, observation: Observation) -> None:
        shape = observation["ball"].shape[:-1]
        for name, value in memory.items():
            if value.shape[: len(shape)] != shape:
                raise ValueError(
                    f"{self._keys[name]!r} has shape {tuple(value.shape)}; expected "
                    f"{tuple(shape)}, as {type(self).__name__} writes it."
                )

    def _observe(self, tensordict: TensorDictBase, where: str) -> Observation:
        ball = self._get(tensordict, "ball", where)
        if not ball.is_floating_point() or ball.ndim == 0 or ball.shape[-1] < 2:
            raise TypeError(
                f"{self._keys['ball']!r} in {where} is {ball.dtype} of shape {tuple(ball.shape)}; "
                "expected floating point of shape (..., 2 or more): x and y on the pitch first."
            )
        observation = {"ball": ball}
        for name in self._observations:
            if name not in self._keys:
                observation[name] = ball.new_zeros(ball.shape[:-1], dtype=torch.int64)
            elif name != "ball":
                value = self._get(tensordict, name, where)
                observation[name] = _as_field(name, value, ball.shape[:-1], self._keys[name], where)
        return observation

    def _observe_result(self, following: TensorDictBase, where: str) -> Observation:
        """Read what a step led to."""
        return self._observe(following, where)

    def _recall(
        self,
        tensordict: TensorDictBase,
        following: TensorDictBase,
        observation: Observation,
        scoring: Tensor,
    ) -> Memory:
        """Work out the memory before each step of stored, ordered steps."""
        if not tensordict.batch_dims:
            without, store = self._why_recalled()
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
        done = self._get(following, "done", "'next'").reshape(shape)
        self._check_ordered(before, observation, done, time)

        return self._memory_before(first, observation, scoring, done, time)

    def _memory_before(
        self, first: Memory, observation: Observation, scoring: Tensor, done: Tensor, time: int
    ) -> Memory:
        """Work out the memory before each of several ordered steps.

        Args:
            first: memory before each step if an episode began with it; that of the very first step
                is taken as it is.
            observation: what each step led to.
            scoring: its scoring reward, (..., 1).
            done: whether an episode ended with it, (...).
            time: dimension along which the steps follow each other.
        """
        steps = unbind(observation, time)
        scorings = scoring.squeeze(-1).unbind(time)

        def remember(step: int, memory: Memory) -> Memory:
            if self._stored_memory_is_valid:
                return self._remember(memory, steps[step], scorings[step])
            return self._advance(memory, steps[step], scorings[step])[0]

        return memory_before_steps(first, done, remember, time)

    def _check_ordered(
        self, before: Observation, after: Observation, done: Tensor, time: int
    ) -> None:
        pairs = done.shape[time] - 1
        ended = done.narrow(time, 0, pairs)
        for name in self._observations:
            reached = after[name].narrow(time, 0, pairs)
            left = before[name].narrow(time, 1, pairs)
            same = (reached == left) | ((reached != reached) & (left != left))
            if same.ndim > done.ndim:
                same = same.flatten(done.ndim).all(-1)
            if not bool((same | ended).all()):
                without, store = self._why_recalled()
                raise ValueError(
                    f"{without}, {type(self).__name__} needs consecutive steps along "
                    f"batch dimension {time}, but {self._keys[name]!r} of some step is not what "
                    f"the step before led to. {store}Relabel the trajectory before shuffling it, "
                    "or name its time dimension 'time'. With a SliceSampler, call this transform "
                    "on what it returns."
                )

    def _why_recalled(self) -> tuple[str, str]:
        if not self._stored_memory_is_valid:
            return "With a memory that depends on the reward", ""
        memory = " and ".join(repr(self._keys[name]) for name in self._memory)
        return f"Without {memory}", "Store it with the data. Or: "

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the memory."""
        for name, spec in self._memory_specs(observation_spec).items():
            observation_spec[self._keys[name]] = spec
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Add the memory to what a step needs, so that batched environments hand it on."""
        observation_spec = self.parent.full_observation_spec
        for name, spec in self._memory_specs(observation_spec).items():
            state_spec[self._keys[name]] = spec
        return state_spec

    def _memory_specs(self, observation_spec: Composite) -> dict[str, Unbounded]:
        present = observation_spec.keys(True, True)
        example = TensorDict(batch_size=observation_spec.shape, device=observation_spec.device)
        for name in self._observations:
            key = self._keys.get(name, None)
            if key is None:
                continue
            if key not in present:
                raise KeyError(
                    f"{type(self).__name__} found no {key!r} among the environment's "
                    f"observations {sorted(map(str, present))}. Pass keys={{{name!r}: <its key>}}."
                )
            example.set(key, observation_spec[key].zero())
        first = self._first_memory(self._observe(example, "the environment's observations"))
        return {
            name: Unbounded(value.shape, dtype=value.dtype, device=value.device)
            for name, value in first.items()
        }


def _as_field(name: str, value: Tensor, shape: torch.Size, key: NestedKey, where: str) -> Tensor:
    is_float, of_match = name in FLOAT_FIELDS, FIELD_SHAPES.get(name, ())
    if is_float != value.is_floating_point() or value.is_complex() or value.dtype == torch.bool:
        expected, method = ("floating point", "float") if is_float else ("an integer", "long")
        raise TypeError(
            f"{key!r} in {where} is {value.dtype}; expected {expected}. Convert it with "
            f".{method}()."
        )
    if not of_match and value.shape == (*shape, 1):
        value = value.squeeze(-1)
    elif value.shape != (*shape, *of_match):
        other = "" if of_match else f" like the ball, or {(*shape, 1)}"
        raise ValueError(
            f"{key!r} in {where} has shape {tuple(value.shape)}; expected {(*shape, *of_match)}"
            f"{other}."
        )
    return value if is_float else value.long()
