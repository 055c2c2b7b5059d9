"""What collects batches for PPO, and the simplest that does."""

from __future__ import annotations

import abc
import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import EnvBase

from fbrl.models.actor_critic import CollectionPolicy


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

        Returns:
            ``matches``, the state of each, ``kept_states``, in which others may begin, and
            ``next_step``, what the policy is to look at and what is remembered of the episodes so
            far; all empty where it can't be told.
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
        batch: TensorDictBase = torch.stack(steps, -1)
        return batch

    def close(self) -> None:
        """See :meth:`BatchCollector.close`."""
        self._env.close()


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
