"""How often each reading of transition(s, s') fires, per 10,000 steps.

    python experiments/transition_firing_rates/measure.py academy_3_vs_1_with_keeper
    python experiments/transition_firing_rates/measure.py academy_3_vs_1_with_keeper --run RUN_DIR

Both readings look at the same steps: the matches are played once, and the stored steps are
relabelled with the reward in either reading, over densities that are 1 everywhere, so that a
received pass counts wherever it happens.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import torch
from torchrl.modules.tensordict_module.exploration import RandomPolicy

from fbrl.agent import load_agent
from fbrl.density import AssistDensity, PositionDensity
from fbrl.envs import make_env
from fbrl.transforms import AssistDensityReward

NUM_ENVS = 8
EVERYWHERE = PositionDensity(torch.ones(2, 2), peak=1.0)


def measure(scenario: str, run: Path | None, steps: int, seed: int) -> dict[str, float | str]:
    """Plays a random or a trained policy and counts received passes in both readings."""
    torch.manual_seed(seed)
    rewards = {
        transition: AssistDensityReward(
            AssistDensity(EVERYWHERE, EVERYWHERE), transition=transition
        )
        for transition in ("possession", "consecutive")
    }
    raw_keys = [key for key in rewards["possession"].in_keys if key != "reward"]
    agent = None if run is None else load_agent(run)
    env = make_env(
        scenario,
        num_envs=NUM_ENVS,
        reward="scoring",
        observation="simple115" if agent is None else agent.config.observation,
        frame_skip=1 if agent is None else agent.config.ppo.frame_skip,
        keep_keys=raw_keys,
        seed=seed,
    )
    if agent is None:
        policy = RandomPolicy(env.full_action_spec)
    else:
        policy = agent.model.get_collection_policy()
    with torch.no_grad():
        played = env.rollout(steps // NUM_ENVS, policy, break_when_any_done=False)
    env.close()
    per_10_000 = 10_000 / played.numel()
    row: dict[str, float | str] = {
        "scenario": scenario,
        "policy": "random" if agent is None else f"trained for {agent.frames:,} frames",
        "steps": played.numel(),
        "matches": int(played["next", "done"].sum()),
    }
    for transition, reward in rewards.items():
        relabelled = reward(played.clone())["next"]
        received = relabelled["reward_end_density"] > 0
        row[transition] = round(int(received.sum()) * per_10_000, 1)
    with_ball = relabelled["reward_start_density"] > 0
    row["steps_with_ball"] = round(int(with_ball.sum()) * per_10_000, 1)
    return row


def main() -> None:
    """Parses the command line, measures and prints a row of CSV."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenario")
    parser.add_argument("--run", type=Path, help="run directory; a random policy without it")
    parser.add_argument("--steps", type=int, default=40_000, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    options = parser.parse_args()
    row = measure(options.scenario, options.run, options.steps, options.seed)
    table = csv.DictWriter(sys.stdout, list(row))
    table.writeheader()
    table.writerow(row)


if __name__ == "__main__":
    main()
