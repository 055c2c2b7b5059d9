"""Collects one batch while another is learned from."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

from tensordict import TensorDictBase

from fbrl.collect.collector import RolloutCollector
from fbrl.models.actor_critic import CollectionPolicy


class AheadCollector:
    """Collects the next batch in a thread while the present one is learned from.

    What is learned from was therefore collected with the weights of one update before: its
    log-probabilities are those weights', so that PPO's ratio is right, but does not begin at 1. It
    pays where a GPU learns while the cores would be idle. The threads' timing decides the order of
    the random numbers, so that no two trainings are equal.

    Args:
        collector: Collects with a copy of the policy.
        policy: What is learned; its weights are copied before each batch.

    Attributes:
        state: What the batch in flight, or the next one, began with.
    """

    def __init__(self, collector: RolloutCollector, policy: CollectionPolicy) -> None:
        self._collector = collector
        self._policy = policy
        self._thread = ThreadPoolExecutor(1, "collector")
        self._in_flight: Future[TensorDictBase] | None = None
        self.state: TensorDictBase | None = None

    def reset(self) -> None:
        """Starts an episode in every match."""
        self.state = self._collector.reset()

    def collect(self, *, is_last: bool, before_next: Callable[[], None]) -> TensorDictBase:
        """Waits for the batch in flight and lets the next one begin.

        Args:
            is_last: No batch is to follow.
            before_next: Called when no match is being played, before the next batch.

        Returns:
            A batch as :meth:`RolloutCollector.collect` returns it.
        """
        if self._in_flight is None:
            self._collector.state = self.state
            self._begin()
        assert self._in_flight is not None
        # The next batch takes the place of this one in the collector.
        batch = self._in_flight.result().clone()
        self._in_flight = None
        self.state = self._collector.state
        if not is_last:
            before_next()
            self._begin()
        return batch

    def wait(self) -> None:
        """Waits until the batch in flight is there; the next one begins with :meth:`collect`."""
        if self._in_flight is not None:
            wait([self._in_flight])

    def close(self) -> None:
        """Waits until no match is being played any more."""
        self._thread.shutdown()

    def _begin(self) -> None:
        self._collector.policy.load_state_dict(self._policy.state_dict())
        self._in_flight = self._thread.submit(self._collector.collect)
