"""Densities fitted to coordinates of your own, and the reward that pays with them.

gfootball is not needed to fit them. fbrl-train --reward.density FILE trains on the file that is
written.
"""

import argparse

import numpy as np
import torch
from tensordict import TensorDict

from fbrl.density import fit_assist_density
from fbrl.transforms import AssistDensityReward


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="crosses.npz")
    out = parser.parse_args().out

    # Where passes were played from and received, (n, 2) each: crosses from either wing. The pitch
    # is [-1, 1] x [-0.42, 0.42], attacked to the right; fbrl.density.pitch_from_statsbomb converts
    # StatsBomb's coordinates.
    random = np.random.default_rng(0)
    wing = random.choice([-1, 1], 300)
    starts = np.stack([random.uniform(0.7, 0.9, 300), wing * random.uniform(0.3, 0.4, 300)], 1)
    ends = np.stack([random.uniform(0.75, 0.98, 300), random.uniform(-0.2, 0.2, 300)], 1)

    density = fit_assist_density(starts, ends, source="made-up crosses")
    density.save(out)
    print(f"{out}: {density.metadata.n} passes, peaks {density.start.peak} and {density.end.peak}")

    ball = torch.tensor([[0.8, 0.35, 0.0], [0.9, 0.0, 0.0], [0.0, 0.0, 0.0]])
    at_the_feet_of = torch.tensor([9, 9, 9])
    received = TensorDict(
        ball=ball,
        ball_owned_player=at_the_feet_of,
        active=at_the_feet_of,
        reward=torch.zeros(3, 1),
        batch_size=[3],
    )
    step = TensorDict(last_ball_carrier=torch.tensor([7, 7, 7]), next=received, batch_size=[3])
    reward = AssistDensityReward(out, keys={"ball_owned_team": None, "game_mode": None})
    paid = reward(step)["next", "reward"].flatten()
    for place, value in zip(("on the wing", "in front of the goal", "midfield"), paid, strict=True):
        print(f"a pass received {place}: {value:.4f}")


if __name__ == "__main__":
    main()
