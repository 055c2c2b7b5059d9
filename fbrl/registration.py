"""The Gymnasium ids ``fbrl/<scenario>-v0``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from fbrl.scenarios import SCENARIOS

if TYPE_CHECKING:
    from fbrl.envs.vector_env import FootballVectorEnv


def register_scenarios() -> None:
    """Registers all of them, with the time limits that Gymnasium's wrappers ask for."""
    for name, scenario in SCENARIOS.items():
        gymnasium.register(
            id=f"fbrl/{name}-v0",
            entry_point="fbrl.envs.football:FootballEnv",
            vector_entry_point="fbrl.registration:make_vector_env",
            max_episode_steps=scenario.max_steps,
            kwargs={"scenario": name},
        )


def make_vector_env(
    scenario: str, num_envs: int = 1, *, max_episode_steps: int | None, **options: Any
) -> FootballVectorEnv:
    """What ``gymnasium.make_vec`` calls, which names the time limit that is registered.

    Raises:
        ValueError: It names another one.
    """
    from fbrl.envs.vector_env import FootballVectorEnv

    own = SCENARIOS[scenario].max_steps if scenario in SCENARIOS else max_episode_steps
    if max_episode_steps not in (own, None, -1):
        raise ValueError(
            f"max_episode_steps is {max_episode_steps}, but a match of {scenario!r} takes up to "
            f"{own} steps. Write a scenario of your own with another game_duration, or "
            "take vectorization_mode='sync'."
        )
    return FootballVectorEnv(scenario, num_envs, **options)
