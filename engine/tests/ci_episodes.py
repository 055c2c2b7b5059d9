"""The episodes of the tests: 20,000 steps over all scenarios, most of them cheap."""

from __future__ import annotations

from dataclasses import replace

from episodes import STYLES, Episode, with_tackles
from small_pitch import SMALL_PITCH

# How many episodes of a scenario, and how many steps they have at most.
_EPISODES = {
    "academy_empty_goal_close": (15, 120),
    "academy_empty_goal": (15, 120),
    "academy_run_to_score": (10, 100),
    "academy_run_to_score_with_keeper": (10, 100),
    "academy_pass_and_shoot_with_keeper": (15, 120),
    "academy_run_pass_and_shoot_with_keeper": (15, 120),
    "academy_3_vs_1_with_keeper": (15, 150),
    "academy_corner": (5, 100),
    "academy_counterattack_easy": (5, 100),
    "academy_counterattack_hard": (5, 100),
    "academy_single_goal_versus_lazy": (5, 100),
    "1_vs_1_easy": (5, 600),
    "5_vs_5": (5, 300),
    "11_vs_11_easy_stochastic": (2, 200),
    "11_vs_11_stochastic": (2, 200),
    "11_vs_11_hard_stochastic": (2, 200),
    "11_vs_11_competition": (2, 200),
    "11_vs_11_kaggle": (2, 200),
    "test_example_multiagent": (15, 100),
    SMALL_PITCH: (9, 600),
}
# Several players controlled, and what is rarest: penalties, second yellow and red cards.
_OTHERS = [
    Episode("test_example_multiagent", 7, 2, "attack", 100, left_agents=3),
    Episode("11_vs_11_kaggle", 9, 3, "rough", 100, left_agents=11, right_agents=11),
    *(
        replace(
            with_tackles(Episode(SMALL_PITCH, 1000 + index, 2 + index // 2, "", 160)), foul=foul
        )
        for index, foul in enumerate((2, 3, 3, 2))
    ),
    Episode("11_vs_11_stochastic", 1004, 2, "builtin", 160, foul=2, states_every=40),
]
# The least and the greatest that the engine takes.
_EXTREME_SEEDS = {0: 0, 1: 2**32 - 1}


def _episode(scenario: str, place: int, index: int, limit: int) -> Episode:
    episode = Episode(
        scenario,
        _EXTREME_SEEDS.get(index, 1000 * place + index + place % 2),
        2 + index // 2 % 2,
        STYLES[(index + place) % len(STYLES)],
        limit,
        states_every=25 if (index + place) % 5 == 4 else 0,
    )
    return with_tackles(episode) if scenario == SMALL_PITCH else episode


def episodes() -> list[Episode]:
    """Scenario after scenario in turn, so that an engine goes from each one to others.

    Seeds and numbers are even and odd in all four combinations.
    """
    most = max(number for number, _ in _EPISODES.values())
    return [
        _episode(scenario, place, index, limit)
        for index in range(most)
        for place, (scenario, (number, limit)) in enumerate(_EPISODES.items())
        if index < number
    ] + _OTHERS


def saved_episodes() -> list[Episode]:
    """Episodes whose state after the limit is saved and restored; none has ended by then."""
    return [
        with_tackles(Episode(SMALL_PITCH, 1000, 2, "", 120)),
        with_tackles(Episode(SMALL_PITCH, 1001, 3, "", 150)),
        Episode("5_vs_5", 1002, 3, "mixed", 40),
        Episode("11_vs_11_kaggle", 9, 3, "rough", 30),
    ]
