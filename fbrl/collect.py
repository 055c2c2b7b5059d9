"""How experience is collected: the only place that knows the arrangements there are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from fbrl.models.actor_critic import CollectionPolicy
from fbrl.models.impala import ImpalaCNN


def make_collector(env: EnvBase, policy: CollectionPolicy, *, frames_per_batch: int) -> Collector:
    """A collector that steps all matches together in this process.

    The matches run in the environment's own threads on the CPU, where the batches lie too. The
    policy may be on a GPU: it fetches the observation, and nothing else, and hands back what it
    chose, so that each step waits for the GPU once.

    Args:
        env: A vectorised environment with batch size (num_envs,).
        policy: Reads the observation; writes ``action``, ``action_log_prob``, ``state_value``.
        frames_per_batch: Frames of each batch, a multiple of ``num_envs``.

    Returns:
        An endless iterable of batches of shape (num_envs, frames_per_batch // num_envs). A batch is
        valid until the next one is asked for.
    """
    return Collector(
        env,
        # As a function: a module the collector would move to the device that it is told.
        policy.forward,
        frames_per_batch=frames_per_batch,
        # Without end: at the end of its frames a collector closes the environment.
        total_frames=-1,
        device="cpu",
        # Nothing that the collector sees is on a GPU.
        no_cuda_sync=True,
        return_same_td=True,
        track_traj_ids=False,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )


def inference_threads(policy: CollectionPolicy) -> int:
    """Threads of PyTorch's operations while experience is collected.

    A perceptron's few numbers are computed sooner by one thread than spread over several, which
    the threads of the matches would then have to make way for. The convolutional network on a CPU
    takes all.
    """
    is_on_cpu = policy.value_head.weight.device.type == "cpu"
    return torch.get_num_threads() if is_on_cpu and isinstance(policy.trunk, ImpalaCNN) else 1


@contextlib.contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Lets PyTorch's operations on the CPU use this many threads, and as many as before after."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
