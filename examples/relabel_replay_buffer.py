"""Stored matches get the reward afterwards, and the samples of a replay buffer another one.

What was recorded has observations and goals, but nothing of fbrl. gfootball is not needed.
"""

import argparse

import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from fbrl.transforms import AssistDensityPotential, AssistDensityReward


def recorded_matches(matches: int, steps: int) -> TensorDict:
    """Made-up matches of shape (matches, steps): the ball moves to the right from foot to foot."""
    moments = (matches, steps + 1)
    ball = torch.rand(*moments, 3) * 0.4 - 0.2
    ball[..., 0] = torch.linspace(-0.5, 1.0, steps + 1)
    player = torch.randint(0, 11, moments)
    observation = TensorDict(
        ball=ball,
        ball_owned_team=torch.randint(-1, 1, moments),
        ball_owned_player=player,
        active=player,
        game_mode=torch.zeros(moments, dtype=torch.int64),
        batch_size=moments,
    )
    ended = torch.zeros(matches, steps, 1, dtype=torch.bool)
    ended[:, -1] = True
    following = observation[:, 1:].clone()
    following.update({"reward": ended.float(), "done": ended, "terminated": ended})
    return observation[:, :-1].clone().set("next", following)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matches", type=int, default=32)
    parser.add_argument("--steps", type=int, default=100)
    options = parser.parse_args()

    torch.manual_seed(0)
    data = recorded_matches(options.matches, options.steps)
    print(f"mean reward as recorded: {data['next', 'reward'].mean().item():.4f}")

    # Whole trajectories, in order: what the reward has to remember is worked out on the way.
    data = AssistDensityReward()(data)
    print(f"with the densities:      {data['next', 'reward'].mean().item():.4f}")

    # Single steps in any order: what it remembers is in the data by now.
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(data.numel()),
        transform=AssistDensityReward(weight=0.1),
        batch_size=data.numel() // 2,
    )
    buffer.extend(data.reshape(-1))
    print(f"a tenth of them, sampled: {buffer.sample()['next', 'reward'].mean().item():.4f}")

    # The goals were kept apart, so that any other reward can take the place of the first.
    data = AssistDensityPotential(gamma=0.99)(data)
    print(f"as a potential:          {data['next', 'reward'].mean().item():.4f}")


if __name__ == "__main__":
    main()
