"""A scenario of the tests, in which what is rare in gfootball's own happens often, and is cheap.

Few players crowd in front of a goal, with offside and a second half that puts them there again.
With three players of each team that tackle all the time there are fouls, cards and penalties, at
2 ms a step.
"""

from __future__ import annotations

import importlib
from typing import Any

SMALL_PITCH = "small_pitch_of_the_tests"


def build_scenario(builder: Any) -> None:
    """Fills gfootball's scenario; odd episodes have the crowd at the other end."""
    engine: Any = importlib.import_module("gfootball_engine")
    role, team_of = engine.e_PlayerRole, engine.e_Team
    config = builder.config()
    config.game_duration = 3000
    config.second_half = 200
    config.deterministic = False
    config.left_team_difficulty, config.right_team_difficulty = 0.6, 0.95
    at_left_end = builder.EpisodeNumber() % 2 == 0
    end = -1 if at_left_end else 1
    builder.SetBallPosition(0.85 * end, 0.0)
    defenders = (
        (-0.90, 0.06, role.e_PlayerRole_CB),
        (-0.88, -0.06, role.e_PlayerRole_CM),
        (-0.78, 0.0, role.e_PlayerRole_RM),
    )
    attackers = (
        (0.80, -0.01, role.e_PlayerRole_CF),
        (0.84, 0.10, role.e_PlayerRole_LM),
        (0.84, -0.10, role.e_PlayerRole_RM),
    )
    for team, players in (
        (team_of.e_Left, defenders if at_left_end else attackers),
        (team_of.e_Right, attackers if at_left_end else defenders),
    ):
        builder.SetTeam(team)
        builder.AddPlayer(-1.0, 0.0, role.e_PlayerRole_GK)
        for x, y, position in players:
            builder.AddPlayer(x, y, position)
