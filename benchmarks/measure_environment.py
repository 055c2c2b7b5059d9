"""One core's environment: fbrl's against gfootball's own, on the same matches.

All of them play matches whose engine seed is the round's number, with the same random actions, so
that one core does the same work for each; steps and resets are timed apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

NUM_ACTIONS = 19


def fbrl_env(scenario: str, observation: str, seconds: float, seed: int) -> dict[str, float]:
    """``FootballEnv`` with the raw keys of an observation, and its transform.

    For ``"minimap"`` the keys alone, as a network on the device draws the mini maps.
    """
    from tensordict import TensorDict

    from fbrl.envs import FootballEnv
    from fbrl.envs.factory import make_observation

    transform = make_observation(observation)
    env = FootballEnv(scenario, observation_keys=transform.in_keys)

    def observe(raw: dict[str, Any]) -> None:
        if observation != "minimap":
            transform(TensorDict(raw))

    def reset() -> None:
        observe(env.reset(seed=seed)[0])

    def step(action: int) -> bool:
        raw, _, terminated, truncated, _ = env.step(action)
        observe(raw)
        return terminated or truncated

    return _time(reset, step, seconds, seed)


def gfootball_env(
    scenario: str, representation: str, seconds: float, seed: int, stacked: bool = False
) -> dict[str, float]:
    """The environment of gfootball itself, with its own wrappers."""
    from benchmarks.gfootball_env import make_gfootball_env

    env = make_gfootball_env(scenario, representation, stacked=stacked, seed=seed)

    def step(action: int) -> bool:
        done: bool = env.step(action)[2]
        return done

    return _time(env.reset, step, seconds, seed)


def fbrl_training_env(
    scenario: str, observation: str, num_envs: int, seconds: float, seed: int
) -> dict[str, float]:
    """The environment of a training, rewards and stacked mini maps included, on one core."""
    import torch
    from torchrl.envs.utils import step_mdp

    from fbrl.envs import make_env

    env = make_env(scenario, num_envs=num_envs, observation=observation, num_threads=1, seed=seed)
    actions = torch.as_tensor(_actions(seed, num_envs))
    carrier = env.reset()
    steps, resets, stepping, resetting = 0, 0, 0.0, 0.0
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        started = time.perf_counter()
        carrier = env.step(carrier.set("action", actions[steps % len(actions)]))
        ended = int(carrier["next", "done"].sum())
        carrier = step_mdp(carrier)
        stepped = time.perf_counter()
        stepping += stepped - started
        steps += 1
        if ended:
            carrier = env.maybe_reset(carrier)
            resetting += time.perf_counter() - stepped
            resets += ended
    env.close()
    return _figures(steps * num_envs, stepping, resets, resetting)


def _actions(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(NUM_ACTIONS, size=(10_000, *shape))


def _time(
    reset: Callable[[], Any], step: Callable[[int], bool], seconds: float, seed: int
) -> dict[str, float]:
    actions = _actions(seed).tolist()
    # The first reset of a process sets things up that are there for the following ones.
    reset()
    steps, resets, stepping, resetting = 0, 0, 0.0, 0.0
    ended = True
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        started = time.perf_counter()
        if ended:
            reset()
            now = time.perf_counter()
            resetting += now - started
            resets += 1
            started = now
        ended = step(actions[steps % len(actions)])
        stepping += time.perf_counter() - started
        steps += 1
    return _figures(steps, stepping, resets, resetting)


def _figures(steps: int, stepping: float, resets: int, resetting: float) -> dict[str, float]:
    figures = {"steps_per_second": steps / stepping}
    if resets:
        figures["resets_per_second"] = resets / resetting
    return figures
