"""Collects batches by stepping all matches together."""

from __future__ import annotations

import abc
import contextlib
from collections.abc import Iterator

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import EnvBase

from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.models.actor_critic import CollectionPolicy


class BatchCollector(abc.ABC):
    """What collects batches for PPO.

    Attributes:
        state: What the next batch begins with, shape (num_envs,), as far as this process knows it;
            None until the matches have begun.
    """

    def __init__(self) -> None:
        self.state: TensorDictBase | None = None

    @abc.abstractmethod
    def set_seed(self, seed: int) -> None:
        """Seeds the matches that begin with the next reset."""

    @abc.abstractmethod
    def reset(self) -> TensorDictBase:
        """Starts an episode in every match, and returns what they begin with."""

    @abc.abstractmethod
    def collect(self) -> TensorDictBase:
        """Returns a batch of shape (num_envs, num_steps), after a reset the first time."""


class RolloutCollector(BatchCollector):
    """Steps all matches together in this process, batch after batch, without resetting between.

    The matches run in the environment's own threads on the CPU, where the batches lie too. The
    policy may be on a GPU: it fetches the observation, and nothing else, and hands back what it
    chose, so that each step waits for the GPU once.

    TorchRL's ``Collector`` does the same, but has no way to say where the next batch begins or to
    begin one there, which going on with a training takes.

    Args:
        env: A vectorised environment with batch size (num_envs,).
        policy: Reads the observation; writes ``action``, ``action_log_prob``, ``state_value``.
        num_steps: Steps of each match in a batch.
        bookkeeping: What completes each batch, where the environment leaves that to it.

    Attributes:
        policy: As it was given.
        state: What the next batch begins with, shape (num_envs,); None until the environment has
            been reset. A batch that is broken off leaves it as it was.
    """

    def __init__(
        self,
        env: EnvBase,
        policy: CollectionPolicy,
        num_steps: int,
        bookkeeping: EpisodeBookkeeping | None = None,
    ) -> None:
        super().__init__()
        self._env = env
        self.policy = policy
        self._num_steps = num_steps
        self._bookkeeping = bookkeeping
        self._batch: TensorDictBase | None = None

    def set_seed(self, seed: int) -> None:
        """Seeds the matches that begin with the next reset."""
        self._env.set_seed(seed)

    @torch.no_grad()
    def reset(self) -> TensorDictBase:
        """Starts an episode in every match, and returns what they begin with."""
        state = self._env.reset()
        if self._bookkeeping:
            self._bookkeeping.begin(state)
        self.state = state
        return state

    @torch.no_grad()
    def collect(self) -> TensorDictBase:
        """Plays ``num_steps`` steps in each match, after a reset the first time.

        Returns:
            A batch of shape (num_envs, num_steps), valid until the next call.
        """
        start = self.reset() if self.state is None else self.state
        # Left in, the environment would hand them on from step to step.
        state = start.exclude(*self._bookkeeping.keys) if self._bookkeeping else start.copy()
        steps: list[TensorDictBase] = []
        for _ in range(self._num_steps):
            step, state = self._env.step_and_maybe_reset(self.policy.sample(state))
            steps.append(step)
        stacked: TensorDictBase = torch.stack(steps, -1, out=self._batch)
        batch = stacked.copy()
        if self._bookkeeping:
            batch = self._bookkeeping.complete(batch, start, state)
        self._batch, self.state = stacked, state
        return batch


def inference_threads(policy: CollectionPolicy) -> int:
    """Threads of PyTorch's operations while experience is collected.

    A perceptron's few numbers are computed sooner by one thread than spread over several, which
    the threads of the matches would then have to make way for. A convolutional network on a CPU
    takes all.
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
