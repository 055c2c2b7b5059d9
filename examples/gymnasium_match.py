"""FootballEnv with plain Gymnasium: a player who runs to the right and shoots near the goal."""

import argparse

import gymnasium

import fbrl  # noqa: F401 (registers the ids fbrl/<scenario>-v0)
from fbrl.envs import ACTION_NAMES

RIGHT, SHOT = ACTION_NAMES.index("right"), ACTION_NAMES.index("shot")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matches", type=int, default=5)
    matches = parser.parse_args().matches

    # Of the observation's 23 entries only those that are needed, which is faster.
    env = gymnasium.make("fbrl/academy_empty_goal-v0", observation_keys=["ball", "steps_left"])
    for match in range(matches):
        observation, _ = env.reset(seed=match)
        terminated = truncated = False
        while not (terminated or truncated):
            action = SHOT if observation["ball"][0] > 0.7 else RIGHT
            observation, reward, terminated, truncated, _ = env.step(action)
        print(f"match {match}: goals {reward:+.0f}, {observation['steps_left'].item()} steps left")
    env.close()


if __name__ == "__main__":
    main()
