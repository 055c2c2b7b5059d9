"""Matches on the nodes of a Ray cluster, played by workers with a policy each."""

from __future__ import annotations

import concurrent.futures
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ray
import torch
from ray.exceptions import ObjectLostError, RayActorError
from ray.util.placement_group import placement_group, remove_placement_group
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.collectors.distributed import RayCollector
from torchrl.envs import EnvBase, ExplorationType

from fbrl.agent import make_model
from fbrl.collect.collector import BatchCollector, inference_threads
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.collect.ray_cluster import workers_and_cpus
from fbrl.collect.watchdog import Watchdog
from fbrl.config import ConfigError, TrainConfig
from fbrl.envs.factory import make_env
from fbrl.envs.process_vector_env import MAX_RESTARTS, MatchWorkersError
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.transforms import ScoringReward

START_TIMEOUT = 120
"""Seconds after which a worker that finds no place in the cluster, or does not start, is an error.
"""


class MatchCollector(Collector):
    """A worker: TorchRL's collector, which takes the weights with the order for a batch.

    Args:
        create_env_fn: Makes the worker's matches.
        hang_timeout: Seconds that one step of a match may take before the worker ends itself, to
            be replaced; 0 for any time.
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
        torch.set_num_threads(inference_threads(self.policy))
        Watchdog(hang_timeout, _end_worker).__enter__()

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


def _end_worker(matches: Sequence[str]) -> None:
    print(f"The engine hangs: {', '.join(matches)}.", file=sys.stderr, flush=True)
    os._exit(1)


@dataclass(frozen=True)
class _MakeMatches:
    """Makes a worker's matches where the worker is."""

    config: TrainConfig
    num_envs: int
    num_threads: int
    # Ray begins a worker anew with its arguments, but keeps only small ones for that.
    reward: ray.ObjectRef

    def __call__(self) -> EnvBase:
        return make_env(
            self.config.scenario,
            num_envs=self.num_envs,
            num_threads=self.num_threads,
            reward=ray.get(self.reward),
            observation=self.config.observation,
        )


@dataclass(frozen=True)
class _MakePolicy:
    """Makes a worker's policy, whose weights come with each order for a batch."""

    config: TrainConfig

    def __call__(self) -> CollectionPolicy:
        return make_model(self.config, torch.device("cpu")).get_collection_policy()


class RayMatchCollector(BatchCollector):
    """Collects batches from workers on the nodes of the cluster that Ray is connected to.

    All begin a batch with the same weights, and the batch is whole when the last one is done. A
    worker that dies, alone or with its node, is begun anew by Ray, on another node if need be; its
    part of the batch is played again, in new matches. Workers and matches are seeded, so that the
    same training with as many workers has the same batches as long as none dies.

    TorchRL's ``RayCollector`` makes and ends the workers, but does not play the batches: its
    iterator ends with the first worker that dies, and the process group that it sends the weights
    through by default neither takes a new member nor listens on one interface only. Here they go
    through Ray's object store.

    Args:
        config: The training.
        policy: Its weights are sent before each batch; it may be on any device.
        reward: Computed by the workers.
        seed: Seeds the matches and the choice of actions.
        on_restart: Called with one line about each worker that is replaced.
        max_restarts: How often that may happen, to all workers together; by default as often as
            with processes.

    Attributes:
        lost_matches: Matches that were lost so far.

    Raises:
        ConfigError: The cluster is too small or in use, or the workers can't start there.
    """

    def __init__(
        self,
        config: TrainConfig,
        policy: CollectionPolicy,
        reward: ScoringReward,
        *,
        seed: int,
        on_restart: Callable[[str], None] = lambda line: None,
        max_restarts: int | None = None,
    ) -> None:
        super().__init__()
        self._policy = policy
        self._scenario = config.scenario
        self._num_envs = config.ppo.num_envs
        self._on_restart = on_restart
        self._restarts_left = MAX_RESTARTS if max_restarts is None else max_restarts
        self.lost_matches = 0
        self._seeds: list[int | None] = []
        self._reward = ray.put(reward)
        workers, cpus = workers_and_cpus(config)
        self._share = self._num_envs // workers
        self._placement = placement_group([{"CPU": cpus}] * workers, strategy="SPREAD")
        try:
            self._collector = self._start(config, reward, workers, cpus)
        except BaseException as error:
            remove_placement_group(self._placement)
            if isinstance(error, RayActorError):
                raise ConfigError(f"A Ray worker can't start: {_last_line(error)}") from error
            raise
        self._workers = self._collector.remote_collectors
        self.set_seed(seed)

    def _start(
        self, config: TrainConfig, reward: ScoringReward, workers: int, cpus: int
    ) -> RayCollector:
        if not self._placement.wait(START_TIMEOUT):
            raise ConfigError(
                f"The Ray cluster has had no room for {workers} workers of {cpus} CPUs within "
                f"{START_TIMEOUT} s: others use it. Wait, or ask for less with --num-workers "
                "and --num-threads."
            )
        places = [
            PlacementGroupSchedulingStrategy(self._placement, number) for number in range(workers)
        ]
        with warnings.catch_warnings():
            # It warns that it doesn't send the weights of a policy that it doesn't have.
            warnings.simplefilter("ignore", UserWarning)
            return RayCollector(
                [_MakeMatches(config, self._share, cpus, self._reward)] * workers,
                policy_factory=_MakePolicy(config),
                collector_class=MatchCollector,
                collector_kwargs={
                    "hang_timeout": config.hang_timeout,
                    "drop": EpisodeBookkeeping(reward).keys,
                    "track_traj_ids": False,
                    "auto_register_policy_transforms": False,
                    "trust_policy": True,
                },
                remote_configs=[
                    {"num_cpus": cpus, "max_restarts": -1, "scheduling_strategy": place}
                    for place in places
                ],
                exploration_type=ExplorationType.RANDOM,
                frames_per_batch=config.ppo.frames_per_batch,
                sync=True,
                weight_sync_schemes={},
            )

    def set_seed(self, seed: int) -> None:
        """Seeds what begins with the next :meth:`reset`."""
        self._random = np.random.default_rng(seed)

    def reset(self) -> TensorDictBase:
        """Has all workers begin new matches with the next batch."""
        self._seeds = [self._new_seed() for _ in self._workers]
        # Where the matches are is known to the workers alone.
        self.state = TensorDict(batch_size=[self._num_envs], device="cpu")
        return self.state

    def collect(self) -> TensorDictBase:
        """Has ``num_steps`` steps played in each match, after a reset the first time.

        Returns:
            A batch of shape (num_envs, num_steps) on the CPU.

        Raises:
            MatchWorkersError: Workers died too often, or one that died finds no place any more.
        """
        if self.state is None:
            self.reset()
        weights = ray.put(TensorDict.from_module(self._policy).data.cpu())
        playing = [self._order(number, weights) for number in range(len(self._workers))]
        batches = [self._receive(number, batch, weights) for number, batch in enumerate(playing)]
        self._seeds = [None] * len(self._workers)
        return torch.cat(batches).to("cpu")

    def close(self) -> None:
        """Ends the workers."""
        self._collector.shutdown()
        remove_placement_group(self._placement)

    def _order(self, number: int, weights: ray.ObjectRef) -> ray.ObjectRef:
        return self._workers[number].play.remote(weights, self._seeds[number])

    def _receive(self, number: int, batch: ray.ObjectRef, weights: ray.ObjectRef) -> TensorDictBase:
        """The batch of a worker, from the one that follows it if need be."""
        while True:
            try:
                # In ray.get an exception from a signal's handler would become another one.
                return batch.future().result()
            except (RayActorError, ObjectLostError) as error:
                self._await_successor(number, error)
            batch = self._order(number, weights)

    def _await_successor(self, number: int, error: Exception) -> None:
        self.lost_matches += self._share
        line = (
            f"Ray worker {number}, which plays {self._share} matches of {self._scenario!r}, was "
            f"lost ({type(error).__name__}); {self.lost_matches} matches have been lost so far."
        )
        if not self._restarts_left:
            raise MatchWorkersError(f"{line} That was too often.") from error
        self._restarts_left -= 1
        self._on_restart(f"{line} It is replaced, {self._restarts_left} times more at most.")
        # The first matches of the one before would be played again.
        self._seeds[number] = self._new_seed()
        # Ray begins it anew; only an order that may be repeated waits for that.
        is_ready = self._workers[number].__ray_ready__.options(max_task_retries=-1).remote()
        try:
            is_ready.future().result(START_TIMEOUT)
        except concurrent.futures.TimeoutError:
            raise MatchWorkersError(
                f"{line} For {START_TIMEOUT} s there has been no place in the cluster for another."
            ) from error
        except RayActorError as failure:
            raise MatchWorkersError(
                f"{line} Another one can't start: {_last_line(failure)}"
            ) from failure

    def _new_seed(self) -> int:
        return int(self._random.integers(2**31))


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1].strip()
