"""The Ray cluster that matches, or whole trainings, are spread over."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import Future, TimeoutError
from typing import Any

from fbrl.collect.collector import MatchWorkersError
from fbrl.config import ConfigError, TrainConfig

ADDRESS_VARIABLE = "RAY_ADDRESS"
HEAD_TIMEOUT = 20
"""Seconds without an answer after which the head of the cluster counts as lost. After 60, Ray ends
the process."""


class RayHeadLostError(MatchWorkersError):
    """Raised when the head of the cluster does not answer: without it there are no workers."""


@contextlib.contextmanager
def connected_to_ray(num_cpus: int | None = None) -> Iterator[None]:
    """Connects this process to a Ray cluster, unless it is connected already.

    To that of ``RAY_ADDRESS``, else to the one that ``ray start`` has started on this machine.
    Without either, or with ``RAY_ADDRESS=local``, one of this machine alone is started, without
    Ray's dashboard, and ended with the context. What workers print is in Ray's logs.

    Args:
        num_cpus: CPUs of a cluster that is started; by default those of the machine.

    Raises:
        ConfigError: Ray is not installed, or the cluster can't be reached.

    Examples:
        >>> with connected_to_ray():  # doctest: +SKIP
        ...     ray.nodes()
    """
    try:
        import ray
    except ImportError as error:
        raise ConfigError("Ray is not installed: pip install 'fbrl[ray]'.") from error
    if ray.is_initialized():
        yield
        return
    _connect(num_cpus)
    try:
        yield
    except RayHeadLostError:
        # Whom it would take leave of is not there.
        raise
    except BaseException:
        ray.shutdown()
        raise
    ray.shutdown()


def check_head() -> None:
    """Asks the head of the cluster for a sign of life.

    Raises:
        RayHeadLostError: There was none for :data:`HEAD_TIMEOUT` seconds.
    """
    import ray

    address = ray.get_runtime_context().gcs_address
    answer: Future[list[dict[str, Any]]] = Future()

    def ask() -> None:
        with contextlib.suppress(Exception):
            answer.set_result(ray.nodes())

    # Ray itself would wait without end.
    threading.Thread(target=ask, daemon=True).start()
    # Counted, not measured: a process that stands still does not wait.
    for _ in range(HEAD_TIMEOUT):
        with contextlib.suppress(TimeoutError):
            answer.result(1)
            return
    raise RayHeadLostError(
        f"The head of the Ray cluster at {address} has not answered for {HEAD_TIMEOUT} s, and "
        "without it there is no cluster: start it again with ray start."
    )


def _connect(num_cpus: int | None) -> None:
    import ray

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    address = os.environ.get(ADDRESS_VARIABLE)
    if address not in (None, "auto", "local"):
        host, _, port = address.rpartition(":")
        try:
            # Asks what Ray asks for minutes.
            socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
        except (OSError, ValueError) as error:
            raise ConfigError(_unreachable(address, error)) from error
    try:
        if address != "local":
            ray.init(address="auto", **quiet)
            return
    except ConnectionError as error:
        if address:
            raise ConfigError(_unreachable(address, error)) from error
    from ray._private import ray_constants

    # As on Windows and macOS, where Ray keeps to the loopback interface. It has no option for it,
    # and takes even an address of that interface for the machine's in its network.
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        ray.init(address="local", num_cpus=num_cpus, include_dashboard=False, **quiet)
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = True


def _unreachable(address: str, error: Exception) -> str:
    reason = str(error).splitlines()[0]
    return f"The Ray cluster at {ADDRESS_VARIABLE}={address} can't be reached ({reason})."


def workers_and_cpus(config: TrainConfig) -> tuple[int, int]:
    """How many workers play the matches of a training, and with how many CPUs each.

    What the configuration says, or else a worker for each node, as far as they share the matches
    out evenly, with as many CPUs as each can have on one node.

    Raises:
        ConfigError: The cluster that this process is connected to has no room for them.
    """
    import ray

    cpus = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
    nodes = [number for number in cpus if number]
    workers = config.num_workers or even_share(config.ppo.num_envs, len(nodes))
    wanted = max(1, (config.num_threads or sum(nodes)) // workers)
    if not config.num_threads:
        while wanted > 1 and _places(nodes, wanted) < workers:
            wanted -= 1
    if _places(nodes, wanted) < workers:
        raise ConfigError(
            f"The nodes of the Ray cluster have {', '.join(map(str, nodes)) or 'no'} CPUs: no room "
            f"for {workers} workers with {wanted} each. Set --num-workers and --num-threads lower."
        )
    return workers, wanted


def even_share(num_envs: int, most: int) -> int:
    """The largest number of workers, up to a number, that matches can be shared out to evenly."""
    return next(workers for workers in range(max(most, 1), 0, -1) if num_envs % workers == 0)


def _places(nodes: list[int], wanted: int) -> int:
    return sum(cpus // wanted for cpus in nodes)
