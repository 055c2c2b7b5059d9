"""Rewards that add shaping to scoring and remember something of the episode so far."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from fbrl.transforms.scoring_reward import ScoringReward

Observation = dict[str, Tensor]
"""Observation entries by their usual names; all but ``ball`` have its leading shape."""


class ShapedReward(ScoringReward):
    """Base of the rewards ``reward = reward_scoring + parts``, with an integer memory.

    The memory lives in the tensordict, as :class:`~torchrl.envs.StepCounter`'s count does: the
    root entry is the memory before the action, the one under ``"next"`` the memory after it. The
    module holds no state, so single, batched, vectorised and partially reset environments,
    collectors and stored data all work alike.

    A subclass says what is remembered (:meth:`_first_memory`, :meth:`_remember`) and what is paid
    for it (:meth:`_pay`).

    Args:
        observations: usual names of the observation entries that are read, ``ball`` among them.
        parts: usual names of the parts besides ``reward_scoring``.
        memory: usual name of the memory entry.
        keys: other names for these entries, see :class:`~fbrl.transforms.ScoringReward`.
    """

    def __init__(
        self,
        *,
        observations: Sequence[str],
        parts: Sequence[str],
        memory: str,
        keys: Mapping[str, NestedKey] | None,
    ) -> None:
        self._set_keys(observations, [*parts, memory], keys)
        self._observations = tuple(observations)
        self._parts = tuple(parts)
        self._memory = memory

    @property
    def part_names(self) -> tuple[str, ...]:
        """The usual names of the parts that ``reward`` is the sum of."""
        return ("reward_scoring", *self._parts)

    @abstractmethod
    def _first_memory(self, observation: Observation) -> Tensor:
        """Return the memory at the start of an episode, int64 of shape (...)."""

    @abstractmethod
    def _remember(self, memory: Tensor, observation: Observation, scoring: Tensor) -> Tensor:
        """Return the memory after a step that led to this observation and scoring reward."""

    @abstractmethod
    def _pay(
        self, memory: Tensor, remembered: Tensor, observation: Observation
    ) -> tuple[Tensor, ...]:
        """Return the parts, each of shape (...), for a step between these two memories."""

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        memory = self._first_memory(self._observe(tensordict_reset, "the reset's result"))
        kept = tensordict.get(self._keys[self._memory], None)
        reset = tensordict.get("_reset", None)
        if kept is not None and reset is not None:
            memory = torch.where(reset.reshape(kept.shape), memory, kept)
        return tensordict_reset.set(self._keys[self._memory], memory)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._reset(tensordict, tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory = tensordict.get(self._keys[self._memory], None)
        if memory is None:
            raise KeyError(
                f"{type(self).__name__} found no {self._keys[self._memory]!r} in the tensordict "
                "that was stepped. Step what env.reset() or the previous step returned, with that "
                "entry kept."
            )
        # Never a `reward_scoring` left over from an earlier step of the same tensordict.
        scoring = self._get(next_tensordict, "reward", "the step's result")
        observation = self._observe(next_tensordict, "the step's result")
        self._check_shapes(scoring, observation)
        self._write(next_tensordict, memory, observation, scoring)
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Relabel stored transitions; doing it twice changes nothing.

        The scoring reward is ``reward_scoring`` where it is present, else ``reward``. The memory
        is read from the root; where it is absent, it is worked out along the time dimension: the
        one named ``"time"``, else the last batch dimension. Such data must hold whole, ordered
        steps; a stored window that begins in the middle of an episode starts with the memory of an
        episode that begins there.

        Args:
            tensordict: transitions with the observation at their root and under ``"next"``.

        Returns:
            The same tensordict, with the reward, its parts and the memory set anew.

        Raises:
            KeyError: if an entry is missing.
            ValueError: if the memory is missing and the steps do not follow each other.
        """
        following = self._following(tensordict)
        scoring = self._stored_scoring(following)
        observation = self._observe(following, "'next'")
        self._check_shapes(scoring, observation)
        memory = tensordict.get(self._keys[self._memory], None)
        if memory is None:
            memory = self._recall(tensordict, following, observation, scoring)
            tensordict.set(self._keys[self._memory], memory)
        self._write(following, memory, observation, scoring)
        return tensordict

    def _write(
        self, following: TensorDictBase, memory: Tensor, observation: Observation, scoring: Tensor
    ) -> None:
        remembered = self._remember(memory, observation, scoring.squeeze(-1))
        parts = self._pay(memory, remembered, observation)
        reward = scoring
        for name, part in zip(self._parts, parts, strict=True):
            paid = part.to(torch.float32).unsqueeze(-1)
            following.set(self._keys[name], paid)
            reward = reward + paid
        following.set(self._keys["reward_scoring"], scoring)
        following.set(self._keys["reward"], reward)
        following.set(self._keys[self._memory], remembered)

    def _check_shapes(self, scoring: Tensor, observation: Observation) -> None:
        shape = observation["ball"].shape[:-1]
        if scoring.shape != (*shape, 1):
            raise ValueError(
                f"{self._keys['reward']!r} has shape {tuple(scoring.shape)}, but "
                f"{self._keys['ball']!r} has {tuple(observation['ball'].shape)}; expected a reward "
                f"of shape {(*shape, 1)}."
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
            if name != "ball":
                value = self._get(tensordict, name, where)
                observation[name] = _as_index(value, ball.shape[:-1], self._keys[name], where)
        return observation

    def _recall(
        self,
        tensordict: TensorDictBase,
        following: TensorDictBase,
        observation: Observation,
        scoring: Tensor,
    ) -> Tensor:
        """Work out the memory before each step of stored, ordered steps."""
        if not tensordict.batch_dims:
            raise KeyError(
                f"A single transition without {self._keys[self._memory]!r} cannot be relabelled: "
                "the reward depends on the episode so far. Store that entry with the data, or pass "
                "a whole trajectory."
            )
        names = tensordict.names
        time = names.index("time") if "time" in names else tensordict.batch_dims - 1
        before = self._observe(tensordict, "the root")
        first = self._first_memory(before)
        if not first.shape[time]:
            return first
        done = self._get(following, "done", "'next'").reshape(first.shape)
        self._check_ordered(before, observation, done, time)

        steps = [
            {name: value.select(time, t) for name, value in observation.items()}
            for t in range(first.shape[time])
        ]
        memory, recalled = first, []
        for t, step in enumerate(steps):
            start = first.select(time, t)
            memory = torch.where(done.select(time, t - 1), start, memory) if t else start
            recalled.append(memory)
            memory = self._remember(memory, step, scoring.squeeze(-1).select(time, t))
        return torch.stack(recalled, time)

    def _check_ordered(
        self, before: Observation, after: Observation, done: Tensor, time: int
    ) -> None:
        pairs = done.shape[time] - 1
        ended = done.narrow(time, 0, pairs)
        for name in self._observations:
            reached = after[name].narrow(time, 0, pairs)
            left = before[name].narrow(time, 1, pairs)
            same = (reached == left) | ((reached != reached) & (left != left))
            if name == "ball":
                same = same.all(-1)
            if not bool((same | ended).all()):
                raise ValueError(
                    f"Without {self._keys[self._memory]!r}, {type(self).__name__} needs "
                    f"consecutive steps along batch dimension {time}, but {self._keys[name]!r} of "
                    "some step is not what the step before led to. Store the memory with the data, "
                    "relabel the trajectory before shuffling it, or name its time dimension "
                    "'time'. With a SliceSampler, call this transform on what it returns."
                )

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the memory."""
        observation_spec[self._keys[self._memory]] = self._memory_spec(observation_spec)
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Add the memory to what a step needs, so that batched environments hand it on."""
        observation_spec = self.parent.full_observation_spec
        state_spec[self._keys[self._memory]] = self._memory_spec(observation_spec)
        return state_spec

    def _memory_spec(self, observation_spec: Composite) -> Unbounded:
        present = observation_spec.keys(True, True)
        for name in self._observations:
            if self._keys[name] not in present:
                raise KeyError(
                    f"{type(self).__name__} found no {self._keys[name]!r} among the environment's "
                    f"observations {sorted(map(str, present))}. Pass keys={{{name!r}: <its key>}}."
                )
        ball = observation_spec[self._keys["ball"]]
        return Unbounded(ball.shape[:-1], dtype=torch.int64, device=ball.device)


def _as_index(value: Tensor, shape: torch.Size, key: NestedKey, where: str) -> Tensor:
    if value.is_floating_point() or value.is_complex() or value.dtype == torch.bool:
        raise TypeError(
            f"{key!r} in {where} is {value.dtype}; expected an integer. Convert it with .long()."
        )
    if value.shape == (*shape, 1):
        value = value.squeeze(-1)
    elif value.shape != shape:
        raise ValueError(
            f"{key!r} in {where} has shape {tuple(value.shape)}; expected {tuple(shape)} like the "
            f"ball, or {(*shape, 1)}."
        )
    return value.long()


def in_control(observation: Observation) -> Tensor:
    """Whether the controlled player has the ball: active(s) of the thesis, shape (...)."""
    own_player = observation["ball_owned_player"] == observation["active"]
    return (observation["ball_owned_team"] == 0) & own_player
