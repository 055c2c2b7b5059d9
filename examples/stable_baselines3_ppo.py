"""FootballEnv with Stable-Baselines3, which is installed with: pip install stable-baselines3."""

import argparse

import gymnasium
from gymnasium.wrappers import FlattenObservation
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

import fbrl  # noqa: F401 (registers the ids fbrl/<scenario>-v0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--matches", type=int, default=20)
    options = parser.parse_args()

    keys = ["ball", "ball_direction", "left_team", "left_team_direction", "right_team"]
    env = gymnasium.make("fbrl/academy_empty_goal_close-v0", observation_keys=keys)
    model = PPO("MlpPolicy", FlattenObservation(env), n_steps=512, seed=0, device="cpu")
    model.learn(options.steps)
    mean, deviation = evaluate_policy(model, model.get_env(), options.matches)
    print(f"{options.matches} matches: {mean:.2f} goals a match, deviation {deviation:.2f}")


if __name__ == "__main__":
    main()
