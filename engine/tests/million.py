"""The plan for a million steps: 20 rounds of 50,000, each a cut through all scenarios.

What happens rarely needs many steps; where they are spent was weighed against what they cost on
pip's engine: 7 to 9 ms with 22 players, 3 to 4 with ten, 1 to 3 with fewer. So whole matches of
11 against 11 are 18 %, and the scenario of the tests, where fouls are frequent, 22 %.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from episodes import STYLES, Episode, with_tackles
from small_pitch import SMALL_PITCH

STEPS_PER_ROUND = 50_000

# How many steps of a round; full matches are played whole.
_ACADEMIES = {
    "academy_corner": 1500,
    "academy_counterattack_easy": 1000,
    "academy_counterattack_hard": 1000,
    "academy_single_goal_versus_lazy": 1000,
    "academy_run_to_score": 1500,
    "academy_run_to_score_with_keeper": 1500,
    "academy_pass_and_shoot_with_keeper": 2000,
    "academy_run_pass_and_shoot_with_keeper": 2000,
    "academy_3_vs_1_with_keeper": 2500,
    "academy_empty_goal_close": 2000,
    "academy_empty_goal": 2500,
    "test_example_multiagent": 2500,
}
_SMALL = {SMALL_PITCH: 11_000, "1_vs_1_easy": 3000}
_LIMIT_ON_SMALL_PITCH = 600
_ELEVEN = (
    "11_vs_11_kaggle",
    "11_vs_11_stochastic",
    "11_vs_11_hard_stochastic",
    "11_vs_11_kaggle",
    "11_vs_11_competition",
    "11_vs_11_easy_stochastic",
    "11_vs_11_hard_stochastic",
)
_MATCH_STYLES = ("builtin", "rough", "mixed", "builtin", "rough", "random", "attack")


@dataclass(frozen=True)
class Shard:
    """Episodes of a scenario that one process plays, one after another on one engine.

    Attributes:
        name: Of its file.
        scenario: What is played.
        steps: After so many no other episode is begun.
        styles: The episodes' styles, in turn.
        first_seed: The engine seed of its first episode; the next ones have the next seeds.
        first_number: Likewise.
        states_every: As of :class:`~episodes.Episode`.
    """

    name: str
    scenario: str
    steps: int
    styles: tuple[str, ...]
    first_seed: int
    first_number: int
    states_every: int

    def episodes(self) -> Iterator[Episode]:
        """More episodes than are played."""
        for index in range(self.steps):
            episode = Episode(
                self.scenario,
                self.first_seed + index,
                self.first_number + index,
                self.styles[index % len(self.styles)],
                states_every=self.states_every,
            )
            if self.scenario == SMALL_PITCH:
                yield replace(
                    with_tackles(episode),
                    limit=_LIMIT_ON_SMALL_PITCH,
                    # What follows a foul in the penalty area, in every other episode.
                    foul=(0, 2, 0, 3)[index % 4],
                )
            else:
                yield episode


def shards(rounds: int) -> Iterator[Shard]:
    """The shards of so many rounds, in the order in which they are recorded."""
    for this_round in range(rounds):
        matches = [_ELEVEN[(3 * this_round + index) % len(_ELEVEN)] for index in range(3)]
        wanted = [(name, 3000, True) for name in (*matches, "5_vs_5", "5_vs_5")]
        wanted += [(name, steps, False) for name, steps in {**_SMALL, **_ACADEMIES}.items()]
        for index, (scenario, steps, is_whole_match) in enumerate(wanted):
            style = _MATCH_STYLES[(5 * this_round + index) % len(_MATCH_STYLES)]
            yield Shard(
                f"{this_round:02}-{index:02}-{scenario}",
                scenario,
                steps,
                (style,) if is_whole_match else STYLES,
                # Seeds and numbers of matches are even and odd, in all four combinations.
                100_000 * this_round + 5000 * index + (this_round + index) % 2,
                2 + this_round // 2 % 2,
                # States settle what an engine puts off: most matches are played without.
                100 if this_round % 4 == 3 else 0,
            )
