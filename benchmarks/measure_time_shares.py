"""Where the time of a training goes, measured from outside: functions wrapped in clocks."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks.measure_training import training_config

OTHER = "other"
REWARD_OF_COLLECTION = "reward transform of collection"


class Stopwatch:
    """Seconds by what they were spent on; where calls nest, the innermost counts."""

    def __init__(self, synchronise: Callable[[], None] = lambda: None) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._running = [OTHER]
        self._synchronise = synchronise
        self._since = time.perf_counter()

    def restart(self) -> None:
        """Forgets what was measured so far."""
        self._charge()
        self.seconds.clear()

    @contextlib.contextmanager
    def running(self, name: str) -> Iterator[None]:
        """Charges the time to ``name``, except for what is measured inside."""
        self._charge()
        self._running.append(name)
        try:
            yield
        finally:
            self._charge()
            self._running.pop()

    @contextlib.contextmanager
    def around(self, owner: Any, attribute: str, name: str) -> Iterator[None]:
        """Measures all calls of a function or method, found as an attribute of ``owner``."""
        function = getattr(owner, attribute)

        def measured(*arguments: Any, **keywords: Any) -> Any:
            with self.running(name):
                return function(*arguments, **keywords)

        with mock.patch.object(owner, attribute, measured):
            yield

    def _charge(self) -> None:
        self._synchronise()
        now = time.perf_counter()
        self.seconds[self._running[-1]] += now - self._since
        self._since = now


def time_shares(
    scenario: str, network: str, num_steps: int, iterations: int, device: str, seed: int
) -> dict[str, float]:
    """Trains as ``fbrl-train`` does and measures, without the first iteration, in percent.

    Returns:
        The share of each part; they add up to 100. ``reward transform of collection`` is the
        reward's share of the collection alone.
    """
    import torch

    from fbrl.collect import EpisodeBookkeeping, MatchCollector
    from fbrl.device import choose_device
    from fbrl.envs.engine import load_gfootball
    from fbrl.models.actor_critic import CollectionPolicy
    from fbrl.monitor import Monitor
    from fbrl.ppo import algorithm
    from fbrl.training import TrainListener, train
    from fbrl.transforms import AssistDensityReward

    config = training_config(scenario, network, num_steps, iterations, device, seed)
    is_cuda = choose_device(device).type == "cuda"
    stopwatch = Stopwatch(torch.cuda.synchronize if is_cuda else lambda: None)
    parts = [
        (load_gfootball().engine.Batch, "wait", "matches"),
        (AssistDensityReward, "label", "reward transform"),
        (EpisodeBookkeeping, "complete", "statistics and sums"),
        (MatchCollector, "_look", "observation"),
        (CollectionPolicy, "act", "inference"),
        (algorithm.PPO, "collect", "transfer and batch"),
        (algorithm, "add_advantages", "advantages"),
        (algorithm, "update", "update"),
        (algorithm.PPO, "learn", "minibatches"),
        (Monitor, "log_iteration", "logging"),
    ]
    ends: list[dict[str, float]] = []

    def iteration_ended(*_: object) -> None:
        if not ends:
            stopwatch.restart()
        ends.append(dict(stopwatch.seconds))

    with contextlib.ExitStack() as stack:
        for owner, attribute, name in parts:
            stack.enter_context(stopwatch.around(owner, attribute, name))
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="fbrl-benchmark-"))
        run_dir = Path(directory) / "run"
        train(
            dataclasses.replace(config, run_dir=run_dir), TrainListener(on_metrics=iteration_ended)
        )
    return _shares(ends[-1], dict.fromkeys(name for *_, name in parts))


def _shares(seconds: dict[str, float], names: dict[str, None]) -> dict[str, float]:
    total = sum(seconds.values())
    shares = {name: 100 * seconds.get(name, 0.0) / total for name in [*names, OTHER]}
    collection = ("matches", "reward transform", "statistics and sums", "observation", "inference")
    collected = sum(shares[name] for name in (*collection, "transfer and batch"))
    shares[REWARD_OF_COLLECTION] = 100 * shares["reward transform"] / collected
    return shares
