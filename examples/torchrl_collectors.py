"""TorchRL's own collectors over fbrl's matches, with the batches on a GPU where there is one."""

import argparse
import functools

import torch
from torchrl.collectors import Collector, MultiSyncCollector

from fbrl.envs import make_env
from fbrl.models import build_actor_critic

SCENARIO = "academy_3_vs_1_with_keeper"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=0, help="processes of matches (0: none)")
    parser.add_argument("--frames", type=int, default=2048)
    options = parser.parse_args()

    torch.manual_seed(0)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    policy = build_actor_critic("simple115", device=device).get_collection_policy()
    settings = {
        "frames_per_batch": 512,
        "total_frames": options.frames,
        # The matches are on the CPU; the policy fetches what it reads and returns what it chose.
        "env_device": "cpu",
        "policy_device": device,
        "storing_device": device,
        "trust_policy": True,
        "auto_register_policy_transforms": False,
    }
    if options.workers:
        # Each process has matches, threads and a copy of the policy of its own.
        makers = [
            functools.partial(make_env, SCENARIO, num_envs=4, seed=seed)
            for seed in range(options.workers)
        ]
        collector = MultiSyncCollector(makers, policy, cat_results="stack", **settings)
    else:
        collector = Collector(make_env(SCENARIO, num_envs=8, seed=0), policy, **settings)
    for batch in collector:
        reward = batch["next", "reward"].sum().item()
        place = batch["next", "reward"].device
        print(f"{batch.numel()} frames on {place}, shape {tuple(batch.shape)}: reward {reward:.2f}")
    collector.shutdown()


if __name__ == "__main__":
    main()
