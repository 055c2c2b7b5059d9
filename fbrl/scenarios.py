"""The scenarios that gfootball ships: who plays, for how long, and what ends an episode."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fbrl.checks.names import check_name


@dataclass(frozen=True)
class Scenario:
    """One scenario module of gfootball 2.10.2.

    Attributes:
        name: Module name in ``gfootball/scenarios``.
        left_players: Players of the controlled team, keeper included.
        right_players: Players of the opponents.
        duration: Time limit in steps of 100 ms.
        right_difficulty: Skill of the opponents' built-in player, in [0, 1].
        ends_on_score: A goal ends the episode.
        ends_on_out_of_play: Any stop of the game (ball out, foul, ...) ends the episode.
        ends_on_possession_change: So does losing, or winning, the ball.
        alternating_kick_off: The left team kicks off in every other episode, the first included.
    """

    name: str
    left_players: int
    right_players: int
    duration: int = 400
    right_difficulty: float = 0.6
    ends_on_score: bool = True
    ends_on_out_of_play: bool = True
    ends_on_possession_change: bool = True
    alternating_kick_off: bool = False

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
shaping*, University of Groningen), which calls the last one medium."""


def expand_scenarios(names: Iterable[str]) -> list[str]:
    """The scenarios of a list of scenarios and groups, each once, in order.

    Raises:
        UnknownNameError: There is no scenario or group of a name.
    """
    scenarios = [
        scenario
        for name in names
        for scenario in SCENARIO_GROUPS.get(name) or (_check_scenario_or_group(name),)
    ]
    return list(dict.fromkeys(scenarios))


def check_scenario(name: str) -> str:
    """Returns the name of an existing scenario, one of :data:`SCENARIOS` or the user's own.

    A scenario of one's own is a module in gfootball's ``scenarios`` package, as upstream's
    documentation describes.

    Raises:
        UnknownNameError: There is none of this name.
    """
    if _exists(name):
        return name
    return check_name("scenario", name, SCENARIOS)


def _check_scenario_or_group(name: str) -> str:
    if _exists(name):
        return name
    return check_name("scenario", name, [*SCENARIOS, *SCENARIO_GROUPS])


def _exists(name: str) -> bool:
    return isinstance(name, str) and (name in SCENARIOS or _is_own_scenario(name))


def _is_own_scenario(name: str) -> bool:
    # Asking importlib for the module would import gfootball, and with it gym, before its time.
    package = importlib.util.find_spec("gfootball")
    if package is None or not package.submodule_search_locations:
        return False
    # No file system has longer names.
    if len(name) > 200 or not re.fullmatch(r"[^\W_]\w*(\.[^\W_]\w*)*", name):
        return False
    folder = Path(package.submodule_search_locations[0]) / "scenarios"
    return folder.joinpath(*name.split(".")).with_suffix(".py").is_file()
