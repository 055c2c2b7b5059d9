"""The reward in a TorchRL pipeline of your own, around any environment that has a ball.

The environment is a passing drill in plain Gymnasium; gfootball is not needed. Its entries have
names of their own, and it knows neither opponents nor stops of the game: their keys are None.
"""

import argparse
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box, Dict, Discrete
from torchrl.envs import Compose, GymWrapper, RewardSum, TransformedEnv

from fbrl.transforms import AssistDensityReward


class PassingDrill(gymnasium.Env):
    """Three team-mates run to the right; action i is a pass to player i, or running on with it."""

    observation_space = Dict(
        ball_position=Box(-1.0, 1.0, (2,)), player_with_ball=Box(0, 2, (1,), np.int64)
    )
    action_space = Discrete(3)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        self.x, self.player = 0.0, int(self.np_random.integers(3))
        return self.observe(), {}

    def step(self, action: int) -> tuple[dict, float, bool, bool, dict]:
        self.x, self.player = self.x + 0.04, int(action)
        return self.observe(), 0.0, self.x >= 1.0, False, {}

    def observe(self) -> dict[str, np.ndarray]:
        ball = np.array([self.x, 0.15 * (self.player - 1)], np.float32)
        return {"ball_position": ball.clip(-1, 1), "player_with_ball": np.array([self.player])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50)
    steps = parser.parse_args().steps

    reward = AssistDensityReward(
        keys={
            "ball": "ball_position",
            "ball_owned_player": "player_with_ball",
            "active": "player_with_ball",
            "ball_owned_team": None,
            "game_mode": None,
        }
    )
    sums = RewardSum(in_keys=["reward_start_density", "reward_end_density"])
    env = TransformedEnv(GymWrapper(PassingDrill()), Compose(reward, sums))
    torch.manual_seed(0)
    env.set_seed(0)
    data = env.rollout(steps)
    print(f"{len(data)} steps; paid in the episode")
    for part in ("start_density", "end_density"):
        print(f"  {part}: {data['next', f'episode_reward_{part}'][-1].item():.4f}")


if __name__ == "__main__":
    main()
