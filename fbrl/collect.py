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
    device: torch.device,
) -> Collector:
    """A collector that steps all matches together in this process.

    The matches run in the environment's own threads on the CPU; the policy, and the batch that
    is handed out, are on ``device``.

    Args:
        env: A vectorised environment with batch size (num_envs,).
        policy: Reads the observation; writes ``action``, ``action_log_prob``, ``state_value``.
        frames_per_batch: Frames of each batch, a multiple of ``num_envs``.
        device: Where the policy runs and the batches lie.

    Returns:
        An endless iterable of batches of shape (num_envs, frames_per_batch // num_envs). A batch is
        valid until the next one is asked for.
    """
    return Collector(
        env,
        policy,
        frames_per_batch=frames_per_batch,
        # Without end: at the end of its frames a collector closes the environment.
        total_frames=-1,
        env_device="cpu",
        policy_device=device,
        storing_device=device,
        return_same_td=True,
        track_traj_ids=False,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )
