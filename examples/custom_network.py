"""A network of your own with fbrl's PPO."""

import argparse

import torch
from torch import nn

from fbrl.collect import MatchCollector
from fbrl.config import PPOConfig
from fbrl.models import ActorCritic
from fbrl.ppo import PPO


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20_000)
    frames = parser.parse_args().frames

    torch.manual_seed(0)
    # Any module from the observation to features; the policy's and the value's heads are added.
    trunk = nn.Sequential(nn.LayerNorm(115), nn.Linear(115, 128), nn.SiLU(), nn.Linear(128, 64))
    model = ActorCritic(trunk, "simple115", num_features=64, num_actions=19)

    config = PPOConfig(total_frames=frames, num_envs=4, num_steps=128, learning_rate=1e-3)
    collector = MatchCollector(
        "academy_empty_goal_close",
        model.get_collection_policy(),
        num_envs=config.num_envs,
        num_steps=config.num_steps,
        seed=0,
    )
    ppo = PPO(collector, model, config)
    while ppo.frames < config.total_frames:
        batch = ppo.collect()
        losses = ppo.learn(batch)
        matches = max(1, int(batch["next", "done"].sum()))
        goals = batch["next", "reward_scoring"].sum().item() / matches
        print(f"{ppo.frames} frames: {goals:.2f} goals a match, entropy {losses['entropy']:.2f}")
    collector.close()


if __name__ == "__main__":
    main()
