"""What runs on a node of a Ray cluster: matches, and a policy that plays them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import ray
import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from fbrl.collect.collector import inference_threads
from fbrl.collect.watchdog import Watchdog
from fbrl.components import import_modules
from fbrl.config import TrainConfig
from fbrl.models.actor_critic import CollectionPolicy

_HEALTH = "health"

CONCURRENCY_GROUPS = {_HEALTH: 1}
"""Of :class:`MatchCollector`, for Ray: one thread that answers while another one plays."""


class MatchCollector(Collector):
    """A worker: TorchRL's collector, which takes the weights with the order for a batch.

    Args:
        create_env_fn: Makes the worker's matches.
        hang_timeout: Seconds that one step of a match may take before it hangs; 0 for any time.
        drop: Keys of a batch that nothing needs.
        **settings: As for TorchRL's.
    """

    def __init__(
        self,
        create_env_fn: Callable[[], EnvBase],
        *,
        hang_timeout: float,
        drop: Sequence[NestedKey],
        **settings: Any,
    ) -> None:
        super().__init__(create_env_fn, **settings)
        self._drop = drop
        self._hanging: list[str] = []
        torch.set_num_threads(inference_threads(self.policy))
        self._for_good = contextlib.ExitStack()
        self._for_good.enter_context(Watchdog(hang_timeout, self._hanging.extend))

    def play(self, weights: TensorDictBase, seed: int | None) -> TensorDictBase:
        """Plays a batch; one call, so that a worker never plays with the weights it began with.

        Args:
            weights: Those of the policy.
            seed: Begin new matches and random numbers with it; None to play on.

        Returns:
            Shape (matches, num_steps).
        """
        self.update_policy_weights_(weights)
        if seed is not None:
            torch.manual_seed(seed)
            self.set_seed(seed)
            self.reset()
        return self.next().exclude(*self._drop)

    @ray.method(concurrency_group=_HEALTH)
    def get_hanging(self) -> list[str]:
        """Answers also while a batch is played: with the matches that hang, in words."""
        return self._hanging

    @ray.method(concurrency_group=_HEALTH)
    def get_place(self) -> str:
        """Where the worker is, in words."""
        return f"process {os.getpid()} on node {ray.util.get_node_ip_address()}"


@dataclass(frozen=True)
class MakeMatches:
    """Makes a worker's matches where the worker is."""

    config: TrainConfig
    num_envs: int
    num_threads: int
    # Ray begins a worker anew with its arguments, but keeps only small ones for that.
    reward: ray.ObjectRef

    def __call__(self) -> EnvBase:
        """Makes them."""
        # Only in a worker: the one who sends this is imported by it.
        from fbrl.assembly import make_agent_env

        import_modules(self.config.modules)
        return make_agent_env(
            self.config,
            num_envs=self.num_envs,
            num_threads=self.num_threads,
            reward=ray.get(self.reward),
        )


@dataclass(frozen=True)
class MakePolicy:
    """Makes a worker's policy, whose weights come with each order for a batch."""

    config: TrainConfig

    def __call__(self) -> CollectionPolicy:
        """Makes it."""
        from fbrl.assembly import make_model

        import_modules(self.config.modules)
        return make_model(self.config, torch.device("cpu")).get_collection_policy()
