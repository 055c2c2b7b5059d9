"""A reward of your own in thirty lines, played next to fbrl's.

ShapedReward brings the rest: batches, resets of single matches, the parts in TensorBoard, and
relabelling. The same object goes into make_env, into PPO and around other environments.
"""

import argparse

import torch
from torch import Tensor

from fbrl.envs import make_env
from fbrl.transforms import AssistDensityReward, Memory, Observation, ShapedReward, in_control


class ProgressReward(ShapedReward):
    """Pay 0.5 a pitch unit for bringing the ball further forward than before in the episode."""

    def __init__(self) -> None:
        super().__init__(
            observations=("ball", "ball_owned_team", "ball_owned_player", "active"),
            parts=("reward_progress",),
            memory=("furthest_ball",),
        )

    def _first_memory(self, observation: Observation) -> Memory:
        return {"furthest_ball": observation["ball"][..., 0].clone()}

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        before = memory["furthest_ball"]
        now = torch.maximum(before, observation["ball"][..., 0])
        return {"furthest_ball": torch.where(in_control(observation), now, before)}

    def _pay(self, memory: Memory, remembered: Memory, observation: Observation) -> tuple[Tensor]:
        return (0.5 * (remembered["furthest_ball"] - memory["furthest_ball"]),)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400)
    steps = parser.parse_args().steps

    for reward in (AssistDensityReward(), ProgressReward()):
        torch.manual_seed(0)
        env = make_env("academy_3_vs_1_with_keeper", num_envs=2, reward=reward, seed=0)
        data = env.rollout(steps, break_when_any_done=False)
        env.close()
        matches = int(data["next", "done"].sum())
        print(f"{type(reward).__name__}: {matches} matches of random actions; paid in all")
        for part in reward.part_names:
            print(f"  {part}: {data['next', part].sum().item():.4f}")


if __name__ == "__main__":
    main()
