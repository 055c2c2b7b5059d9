"""What collects batches for PPO, the simplest that does, and what is worked out for a batch."""

from __future__ import annotations

import abc
import contextlib
import copy
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.envs import EnvBase

from fbrl.envs.factory import EPISODE_LENGTH, EPISODE_PREFIX
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.transforms import PlayStatistics, ScoringReward
from fbrl.transforms.memory import totals_after_steps


class MatchWorkersError(RuntimeError):
    """Raised when workers that play matches have died, or hung, too often."""


class BatchCollector(abc.ABC):
    """What collects batches for PPO, wherever the matches are played."""

    @abc.abstractmethod
    def set_seed(self, seed: int) -> None:
        """Seeds the matches that begin with the next reset."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Starts an episode in every match."""

    @abc.abstractmethod
    def collect(self) -> TensorDictBase:
        """Plays ``num_steps`` steps in each match, after a reset the first time.

        Returns:
            A batch of shape (num_envs, num_steps) on the CPU, valid until the next call.
        """

    def begin_next(self) -> None:  # noqa: B027 (most have nothing to do)
        """Begins the next batch at once, where it can be collected while one is learned from."""

    def wait(self) -> None:  # noqa: B027
        """Waits until no match is being played; :meth:`collect` goes on from there."""

    def state_dict(self) -> dict[str, Any]:
        """What the next batch begins with, as a checkpoint takes it.

        ``matches``, the state of each, ``kept_states``, in which others may begin, and
        ``next_step``, what the policy is to look at and what is remembered of the episodes so far;
        all empty where it can't be told.
        """
        return {"matches": [], "kept_states": [], "next_step": {}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Has the next batch begin with what :meth:`state_dict` told.

        Raises:
            ValueError: It is not that of such matches, as far as can be seen.
            LookupError: Something is missing in it.
        """
        raise NotImplementedError

    @abc.abstractmethod
    def close(self) -> None:
        """Ends the matches."""


class RolloutCollector(BatchCollector):
    """Steps any TorchRL environment, batch after batch, without resetting between.

    Args:
        env: A vectorised environment with batch size (num_envs,).
        policy: Reads the observation; writes ``action``, ``action_log_prob``, ``state_value``.
        num_steps: Steps of each match in a batch.
    """

    def __init__(self, env: EnvBase, policy: CollectionPolicy, num_steps: int) -> None:
        self._env = env
        self._policy = policy
        self._num_steps = num_steps
        self._state: TensorDictBase | None = None

    def set_seed(self, seed: int) -> None:
        """See :meth:`BatchCollector.set_seed`."""
        self._env.set_seed(seed)

    def reset(self) -> None:
        """See :meth:`BatchCollector.reset`."""
        self._state = self._env.reset()

    @torch.no_grad()
    def collect(self) -> TensorDictBase:
        """See :meth:`BatchCollector.collect`."""
        if self._state is None:
            self.reset()
        steps: list[TensorDictBase] = []
        with torch_threads(inference_threads(self._policy)):
            for _ in range(self._num_steps):
                step, self._state = self._env.step_and_maybe_reset(self._policy.sample(self._state))
                steps.append(step)
        return torch.stack(steps, -1)

    def close(self) -> None:
        """See :meth:`BatchCollector.close`."""
        self._env.close()


class AheadCollector(BatchCollector):
    """Collects the next batch in a thread while the present one is learned from.

    What is learned from was therefore collected with the weights of one update before: its
    log-probabilities are those weights', so that PPO's ratio is right, but does not begin at 1. It
    pays where a GPU learns while the cores would be idle. The threads' timing decides the order of
    the random numbers, so that no two trainings are equal.

    Args:
        make_collector: Makes what collects, with a policy.
        policy: What is learned; a copy collects, which takes its weights before each batch.
    """

    def __init__(
        self, make_collector: Callable[[CollectionPolicy], BatchCollector], policy: CollectionPolicy
    ) -> None:
        self._policy = policy
        self._own_policy = copy.deepcopy(policy)
        self._collector = make_collector(self._own_policy)
        self._thread = ThreadPoolExecutor(1, "collector")
        self._in_flight: Future[TensorDictBase] | None = None
        self._begun_with: dict[str, Any] = {}

    def set_seed(self, seed: int) -> None:
        """See :meth:`BatchCollector.set_seed`."""
        self._collector.set_seed(seed)

    def reset(self) -> None:
        """See :meth:`BatchCollector.reset`."""
        self._collector.reset()

    def collect(self) -> TensorDictBase:
        """Waits for the batch in flight, which it begins if there is none."""
        self.begin_next()
        assert self._in_flight is not None
        # The next batch takes the place of this one in the collector.
        batch: TensorDictBase = self._in_flight.result().clone()
        self._in_flight = None
        return batch

    def begin_next(self) -> None:
        """See :meth:`BatchCollector.begin_next`."""
        if self._in_flight is None:
            self._begun_with = self._collector.state_dict()
            self._own_policy.load_state_dict(self._policy.state_dict())
            self._in_flight = self._thread.submit(self._collector.collect)

    def wait(self) -> None:
        """See :meth:`BatchCollector.wait`."""
        if self._in_flight is not None:
            wait([self._in_flight])

    def state_dict(self) -> dict[str, Any]:
        """What the batch in flight, or else the next one, begins with."""
        return self._collector.state_dict() if self._in_flight is None else self._begun_with

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`BatchCollector.load_state_dict`."""
        self._collector.load_state_dict(state)

    def close(self) -> None:
        """See :meth:`BatchCollector.close`; waits until no match is being played any more."""
        self._thread.shutdown()
        self._collector.close()


class EpisodeBookkeeping:
    """Writes into a batch what :func:`fbrl.envs.make_env`'s environment would have, step by step.

    The reward and its parts, ``play_statistics``, the ``episode_`` sums and ``step_count``: the
    same numbers, bit for bit, which no action depends on. Step by step they cost a tenth of
    collection's time; for a whole batch at once, a hundredth.
    """

    def __init__(self, reward: ScoringReward) -> None:
        self._reward = reward
        self._play_statistics = PlayStatistics()
        self._summed = ("reward", *reward.part_names)
        self._totals = [*(EPISODE_PREFIX + name for name in self._summed), EPISODE_LENGTH]

    @property
    def keys(self) -> tuple[NestedKey, ...]:
        """What :meth:`complete` needs from what came before; nothing else reads it."""
        memories = (*self._reward.memory_keys, *self._play_statistics.memory_keys)
        return (*memories, *self._totals)

    def begin(self, state: TensorDictBase) -> None:
        """Prepares what a reset of all matches returned, shape (num_envs,)."""
        self._reward.begin(state)
        self._play_statistics.begin(state)
        for key in self._totals:
            dtype = torch.int64 if key == EPISODE_LENGTH else torch.get_default_dtype()
            state.set(key, torch.zeros((*state.shape, 1), dtype=dtype))

    def complete(self, batch: TensorDictBase, start: TensorDictBase, end: TensorDictBase) -> None:
        """Writes everything into a batch of steps that follow each other.

        Args:
            batch: Shape (num_envs, num_steps), as the environment's steps left it.
            start: What the first steps went on from, shape (num_envs,).
            end: What the last ones led to, after the resets; it gets what the next batch needs.
        """
        self._reward.label(batch, start, end)
        self._play_statistics.label(batch, start, end)
        following = batch.get("next")
        done = following.get("done").squeeze(-1)
        amounts = [following.get(name) for name in self._summed]
        amounts.append(torch.ones_like(amounts[0]))
        before = torch.cat([start.get(key) for key in self._totals], -1)
        totals = totals_after_steps(before, torch.cat(amounts, -1), done)
        after = totals[:, -1].masked_fill(done[:, -1:], 0)
        for column, key in enumerate(self._totals):
            dtype = start.get(key).dtype
            following.set(key, totals[..., column : column + 1].to(dtype))
            end.set(key, after[..., column : column + 1].to(dtype))


def inference_threads(policy: CollectionPolicy) -> int:
    """Threads of PyTorch's operations while experience is collected.

    One computes a perceptron's few numbers sooner than several, which the matches' threads would
    have to make way for. A convolutional network on a CPU takes all.
    """
    is_on_cpu = policy.value_head.weight.device.type == "cpu"
    convolves = any(isinstance(module, nn.Conv2d) for module in policy.trunk.modules())
    return torch.get_num_threads() if is_on_cpu and convolves else 1


@contextlib.contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Lets PyTorch's operations on the CPU use this many threads, and as many as before after."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
