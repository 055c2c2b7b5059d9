"""What runs on a node of a Ray cluster: matches, and a policy that plays them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from typing import Any

import ray
import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from fbrl.collect.collector import inference_threads
from fbrl.collect.watchdog import Watchdog
from fbrl.config import TrainConfig
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.registry import import_modules

_HEALTH = "health"

CONCURRENCY_GROUPS = {_HEALTH: 1}
"""Of :class:`MatchCollector`, for Ray: one thread that answers while another one plays."""


class MatchCollector(Collector):
    """A worker: TorchRL's collector, which takes the weights with the order for a batch.

    Args:
        create_env_fn: Makes the worker's matches.
        hang_timeout: Seconds that one step of a match may take; 0 for any time.
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
        """Plays a batch of shape (matches, num_steps) with these weights.

        With a seed it begins new matches and random numbers.
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


# fbrl.assembly leads back to this module, so that these import it when they are called.


def make_matches(
    config: TrainConfig, num_envs: int, num_threads: int, reward: ray.ObjectRef
) -> EnvBase:
    """Makes a worker's matches where the worker is.

    The reward is a reference: Ray begins a worker anew with its arguments, but keeps only small
    ones for that.
    """
    from fbrl.assembly import make_agent_env

    import_modules(config.modules)
    return make_agent_env(
        config, num_envs=num_envs, num_threads=num_threads, reward=ray.get(reward)
    )


def make_policy(config: TrainConfig) -> CollectionPolicy:
    """Makes a worker's policy, whose weights come with each order for a batch."""
    from fbrl.assembly import make_model

    import_modules(config.modules)
    return make_model(config, torch.device("cpu")).get_collection_policy()
