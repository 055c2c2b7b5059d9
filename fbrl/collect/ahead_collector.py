"""Collects one batch while another is learned from."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from tensordict import TensorDictBase

from fbrl.collect.collector import BatchCollector
from fbrl.models.actor_critic import CollectionPolicy


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
