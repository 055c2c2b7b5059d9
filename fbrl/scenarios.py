"""The scenarios that gfootball ships, and their Gymnasium ids ``fbrl/<scenario>-v0``."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from fbrl.checks import check_name

if TYPE_CHECKING:
    from fbrl.envs.vector_env import FootballVectorEnv


SECONDS_PER_FRAME = 0.1
"""Of a match, where the game is not interrupted."""

LARGEST_FRAME_SKIP = 100
"""Ten seconds of a match for one action."""


@dataclass(frozen=True)
class Scenario:
    """One scenario module of gfootball 2.10.2."""

    name: str
    """Module name in ``gfootball/scenarios``."""
    left_players: int
    """Of the controlled team, keeper included."""
    right_players: int
    """Of the opponents."""
    duration: int = 400
    """Time limit in steps of 100 ms."""
    right_difficulty: float = 0.6
    """Skill of the opponents' built-in player, in [0, 1]."""
    ends_on_score: bool = True
    """A goal ends the episode."""
    ends_on_out_of_play: bool = True
    """Any stop of the game (ball out, foul, ...) ends the episode."""
    ends_on_possession_change: bool = True
    """So does losing, or winning, the ball."""
    alternating_kick_off: bool = False
    """The left team kicks off in every other episode, the first included."""

    @property
    def max_steps(self) -> int:
        """Steps of the longest episode: as in gfootball, the one that reaches the limit is more."""
        return self.duration + 1

    @property
    def source(self) -> str:
        """The file that defines it, inside the gfootball package."""
        return f"gfootball/scenarios/{self.name}.py"


def _full_match(name: str, players: int, difficulty: float, duration: int = 3000) -> Scenario:
    return Scenario(
        name,
        players,
        players,
        duration,
        difficulty,
        ends_on_score=False,
        ends_on_out_of_play=False,
        ends_on_possession_change=False,
        alternating_kick_off=True,
    )


SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("academy_empty_goal_close", 2, 1),
        Scenario("academy_empty_goal", 2, 1),
        Scenario("academy_run_to_score", 2, 6),
        Scenario("academy_run_to_score_with_keeper", 2, 6),
        Scenario("academy_pass_and_shoot_with_keeper", 3, 2),
        Scenario("academy_run_pass_and_shoot_with_keeper", 3, 2),
        Scenario("academy_3_vs_1_with_keeper", 4, 2),
        Scenario("academy_corner", 11, 11, ends_on_possession_change=False),
        Scenario("academy_counterattack_easy", 11, 11),
        Scenario("academy_counterattack_hard", 11, 11),
        Scenario("academy_single_goal_versus_lazy", 11, 11, duration=3000),
        _full_match("1_vs_1_easy", 1, 0.0, duration=500),
        _full_match("5_vs_5", 5, 0.05),
        _full_match("11_vs_11_easy_stochastic", 11, 0.05),
        _full_match("11_vs_11_stochastic", 11, 0.6),
        _full_match("11_vs_11_hard_stochastic", 11, 0.95),
        _full_match("11_vs_11_competition", 11, 1.0),
        _full_match("11_vs_11_kaggle", 11, 1.0),
        Scenario("test_example_multiagent", 4, 2, duration=100),
    )
}


SCENARIO_GROUPS: dict[str, tuple[str, ...]] = {
    "all-academy": tuple(name for name in SCENARIOS if name.startswith("academy_")),
    "thesis": (
        "academy_3_vs_1_with_keeper",
        "academy_counterattack_easy",
        "academy_counterattack_hard",
        "11_vs_11_easy_stochastic",
        "11_vs_11_stochastic",
    ),
}
"""Names for several scenarios at once: those of the academy, and those of the thesis (*Enhancing
football simulation performance in deep reinforcement learning through analytics-based dense reward
shaping*, University of Groningen), where the last one is called medium."""


def expand_scenarios(names: Iterable[str]) -> list[str]:
    """The scenarios of a list of scenarios and groups, each once, in order.

    Raises:
        UnknownNameError: There is no scenario or group of a name.
    """
    scenarios: list[str] = []
    for name in names:
        if name not in SCENARIO_GROUPS and not _exists(name):
            check_name("scenario", name, [*SCENARIOS, *SCENARIO_GROUPS])
        scenarios += SCENARIO_GROUPS.get(name, (name,))
    return list(dict.fromkeys(scenarios))


def check_scenario(name: str) -> str:
    """Returns the name of an existing scenario, one of :data:`SCENARIOS` or of one's own.

    That is a module in gfootball's ``scenarios`` package, as upstream's documentation describes.

    Raises:
        UnknownNameError: There is none of this name.
    """
    return name if _exists(name) else check_name("scenario", name, SCENARIOS)


def _exists(name: str) -> bool:
    if not isinstance(name, str):
        return False
    if name in SCENARIOS:
        return True
    # Asking importlib for the module would import gfootball, and with it gym, before its time.
    package = importlib.util.find_spec("gfootball")
    if package is None or not package.submodule_search_locations:
        return False
    # No file system has longer names.
    if len(name) > 200 or not re.fullmatch(r"[^\W_]\w*(\.[^\W_]\w*)*", name):
        return False
    folder = Path(package.submodule_search_locations[0]) / "scenarios"
    return folder.joinpath(*name.split(".")).with_suffix(".py").is_file()


def register_scenarios() -> None:
    """Registers the ids, with the time limits that Gymnasium's wrappers ask for."""
    for name, scenario in SCENARIOS.items():
        gymnasium.register(
            id=f"fbrl/{name}-v0",
            entry_point="fbrl.envs.football:FootballEnv",
            vector_entry_point="fbrl.scenarios:make_vector_env",
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
