"""How experience is collected: the only place that knows the arrangements there are."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase


def make_collector(
    env: EnvBase,
    policy: TensorDictModuleBase,
    *,
    frames_per_batch: int,
    total_frames: int,
    device: torch.device,
) -> Collector:
    """A collector that steps all matches together in this process.

    The matches run in the environment's own threads on the CPU; the policy, and the batch that
    is handed out, are on ``device``.

    Args:
        env: A vectorised environment with batch size (num_envs,).
        policy: Reads the observation; writes ``action``, ``action_log_prob``, ``state_value``.
        frames_per_batch: Frames of each batch, a multiple of ``num_envs``.
        total_frames: Frames of all batches.
        device: Where the policy runs and the batches lie.

    Returns:
        An iterable of batches of shape (num_envs, frames_per_batch // num_envs). A batch is
        valid until the next one is asked for.
    """
    return Collector(
        env,
        policy,
        frames_per_batch=frames_per_batch,
        total_frames=total_frames,
        env_device="cpu",
        policy_device=device,
        storing_device=device,
        return_same_td=True,
        track_traj_ids=False,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )
