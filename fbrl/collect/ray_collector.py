"""Matches on the nodes of a Ray cluster, played by workers with a policy each."""

from __future__ import annotations

import concurrent.futures
import contextlib
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np
import ray
import torch
from ray.exceptions import ObjectLostError, RayActorError
from ray.util.placement_group import placement_group, remove_placement_group
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors.distributed import RayCollector
from torchrl.envs import ExplorationType

from fbrl.collect.collector import BatchCollector, EpisodeBookkeeping, MatchWorkersError
from fbrl.collect.ray_cluster import RayHeadLostError, check_head, workers_and_cpus
from fbrl.collect.ray_worker import CONCURRENCY_GROUPS, MatchCollector, make_matches, make_policy
from fbrl.config import ConfigError, TrainConfig
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.transforms import ScoringReward

START_TIMEOUT = 120
"""Seconds after which a worker that finds no place in the cluster, or does not start, is an error.
"""

SECONDS_BETWEEN_QUESTIONS = 1
"""To a worker that plays, whether it still does."""

MAX_RESTARTS = 10
"""Of all workers together."""

LOGS = "What it printed is on its node, in /tmp/ray/session_latest/logs."


class _WorkerLostError(Exception):
    """A worker has died or hangs; says which of them."""


class _StartedCollector(RayCollector):
    """TorchRL's, which would wait for a worker's start for ever."""

    def add_collectors(self, *args: Any, **kwargs: Any) -> None:
        super().add_collectors(*args, **kwargs)
        started = [worker.__ray_ready__.remote() for worker in self.remote_collectors]
        _, missing = ray.wait(started, num_returns=len(started), timeout=START_TIMEOUT)
        if missing:
            raise ConfigError(
                f"Ray worker {started.index(missing[0])} has not started within {START_TIMEOUT} s. "
                "Look at the nodes with: ray status"
            )


class RayMatchCollector(BatchCollector):
    """Collects batches from workers on the nodes of the cluster that Ray is connected to.

    All begin a batch with the same weights, and the batch is whole when the last one is done. A
    worker that dies or hangs is begun anew by Ray, on another node if need be; its part of the
    batch is played again, in new matches. Workers and matches are seeded, so that the same training
    with as many workers has the same batches as long as none dies.

    TorchRL's ``RayCollector`` makes and ends the workers, but does not play the batches: its
    iterator ends with the first worker that dies, and the process group of its weights takes no new
    member. Here they go through Ray's object store.

    Args:
        config: The training.
        policy: Its weights are sent before each batch; it may be on any device.
        reward: Computed by the workers.
        seed: Of the matches and the choice of actions.
        timeout: Seconds after which a worker that does not answer is replaced; 0 for never. A
            worker answers while it plays, however long a batch takes.
        on_restart: Called with one line about each worker that is replaced.

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
        timeout: float = 20,
        on_restart: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._config = config
        self._policy = policy
        self._timeout = timeout
        self._on_restart = on_restart
        self._restarts_left = MAX_RESTARTS
        self.lost_matches = 0
        self._seeds: list[int | None] = []
        self._is_head_lost = False
        self._reward = ray.put(reward)
        workers, cpus = workers_and_cpus(config)
        self._share = config.ppo.num_envs // workers
        self._placement = placement_group([{"CPU": cpus}] * workers, strategy="SPREAD")
        try:
            self._collector = self._start(config, reward, workers, cpus)
        except BaseException as error:
            remove_placement_group(self._placement)
            if isinstance(error, RayActorError):
                raise ConfigError(f"A Ray worker can't start: {_last_line(error)}") from error
            raise
        self._workers = self._collector.remote_collectors
        self._places = ray.get([worker.get_place.remote() for worker in self._workers])
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
        with warnings.catch_warnings():
            # It warns that it doesn't send the weights of a policy that it doesn't have.
            warnings.simplefilter("ignore", UserWarning)
            return _StartedCollector(
                [partial(make_matches, config, self._share, cpus, self._reward)] * workers,
                policy_factory=partial(make_policy, config),
                collector_class=MatchCollector,
                collector_kwargs={
                    "hang_timeout": config.hang_timeout,
                    "drop": EpisodeBookkeeping(reward).keys,
                    "track_traj_ids": False,
                    "auto_register_policy_transforms": False,
                    "trust_policy": True,
                },
                remote_configs=[
                    {
                        "num_cpus": cpus,
                        "max_restarts": -1,
                        "concurrency_groups": CONCURRENCY_GROUPS,
                        "scheduling_strategy": PlacementGroupSchedulingStrategy(
                            self._placement, number
                        ),
                    }
                    for number in range(workers)
                ],
                exploration_type=ExplorationType.RANDOM,
                frames_per_batch=config.ppo.steps_per_batch,
                sync=True,
                weight_sync_schemes={},
            )

    def set_seed(self, seed: int) -> None:
        """See :meth:`BatchCollector.set_seed`."""
        self._random = np.random.default_rng(seed)

    def reset(self) -> None:
        """Has all workers begin new matches with the next batch."""
        self._seeds = [self._new_seed() for _ in self._workers]

    def collect(self) -> TensorDictBase:
        """See :meth:`BatchCollector.collect`.

        Raises:
            MatchWorkersError: Workers died or hung too often, or one that did finds no place any
                more, or the head of the cluster is lost.
        """
        if not self._seeds:
            self.reset()
        self._check_head()
        weights = ray.put(TensorDict.from_module(self._policy).data.cpu())
        playing = [self._order(number, weights) for number in range(len(self._workers))]
        batches = [self._receive(number, batch, weights) for number, batch in enumerate(playing)]
        self._seeds = [None] * len(self._workers)
        return torch.cat(batches).to("cpu")

    def close(self) -> None:
        """Ends the workers, unless there is no cluster any more that they could be in."""
        if self._is_head_lost:
            return
        self._collector.shutdown()
        remove_placement_group(self._placement)

    def _order(self, number: int, weights: ray.ObjectRef) -> ray.ObjectRef:
        return self._workers[number].play.remote(weights, self._seeds[number])

    def _receive(self, number: int, batch: ray.ObjectRef, weights: ray.ObjectRef) -> TensorDictBase:
        """The batch of a worker, or of the one that follows it."""
        while True:
            try:
                return self._await(number, batch.future())
            except (RayActorError, ObjectLostError) as error:
                self._replace(number, f"was lost ({type(error).__name__})")
            except _WorkerLostError as error:
                # Its exit, however it comes about, is no end of the actor for Ray.
                ray.kill(self._workers[number], no_restart=False)
                self._replace(number, str(error))
            batch = self._order(number, weights)

    def _await(self, number: int, batch: Future[TensorDictBase]) -> TensorDictBase:
        """The batch of a worker, unless that does not answer, or a match hangs."""
        ask = self._workers[number].get_hanging.remote
        answer, silence = ask().future(), 0
        while True:
            with contextlib.suppress(concurrent.futures.TimeoutError):
                # In ray.get an exception from a signal's handler would become another one.
                return batch.result(SECONDS_BETWEEN_QUESTIONS)
            self._check_head()
            # Counted, not measured: a process that stands still does not wait.
            silence += SECONDS_BETWEEN_QUESTIONS
            if answer.done():
                if hanging := answer.result():
                    limit = f"more than {self._config.hang_timeout} s"
                    raise _WorkerLostError(
                        f"hangs in the engine: {', '.join(hanging)} took {limit}"
                    )
                answer, silence = ask().future(), 0
            elif self._timeout and silence >= self._timeout:
                raise _WorkerLostError(f"has not answered for {silence} s")

    def _check_head(self) -> None:
        try:
            check_head()
        except RayHeadLostError:
            self._is_head_lost = True
            raise

    def _replace(self, number: int, reason: str) -> None:
        """Waits until Ray has begun a worker anew, unless it has done so too often."""
        self._check_head()
        self.lost_matches += self._share
        line = (
            f"Ray worker {number} ({self._places[number]}), which plays {self._share} matches of "
            f"{self._config.scenario!r}, {reason}; {self.lost_matches} matches have been lost so "
            "far."
        )
        if not self._restarts_left:
            raise MatchWorkersError(f"{line} That was too often. {LOGS}")
        self._restarts_left -= 1
        self._on_restart(f"{line} It is replaced, {self._restarts_left} times more at most.")
        # The first matches of the one before would be played again.
        self._seeds[number] = self._new_seed()
        # Ray begins it anew; only an order that may be repeated waits for that.
        place = self._workers[number].get_place.options(max_task_retries=-1).remote()
        try:
            self._places[number] = place.future().result(START_TIMEOUT)
        except concurrent.futures.TimeoutError as error:
            raise MatchWorkersError(
                f"{line} For {START_TIMEOUT} s there has been no place in the cluster for another: "
                "add a node, or ask for less with --num-workers."
            ) from error
        except RayActorError as error:
            last_line = _last_line(error)
            raise MatchWorkersError(f"{line} Another one can't start: {last_line}") from error

    def _new_seed(self) -> int:
        return int(self._random.integers(2**31))


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1].strip()
