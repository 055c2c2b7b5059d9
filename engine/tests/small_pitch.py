"""A scenario of the tests, in which what is rare in gfootball's own happens often, and is cheap.

Few players stand in and around the left team's penalty area, with offside and a second half: there
are fouls, cards, players sent off, penalties and kick-offs within some hundred steps of 2 ms.
"""

from __future__ import annotations

from typing import Any

SMALL_PITCH = "small_pitch_of_the_tests"


def build_scenario(builder: Any) -> None:
    """Fills gfootball's scenario; odd episodes have the crowd at the other end."""
    from gfootball_engine import e_PlayerRole, e_Team

    config = builder.config()
    config.game_duration = 400
    config.second_half = 200
    config.deterministic = False
    config.left_team_difficulty, config.right_team_difficulty = 0.6, 0.95
    at_left_end = builder.EpisodeNumber() % 2 == 0
    end = -1 if at_left_end else 1
    builder.SetBallPosition(0.72 * end, 0.0)
    defenders = (
        (-0.80, 0.08, e_PlayerRole.e_PlayerRole_CB),
        (-0.78, -0.08, e_PlayerRole.e_PlayerRole_CM),
        (-0.70, 0.02, e_PlayerRole.e_PlayerRole_RM),
    )
    attackers = (
        (0.70, -0.03, e_PlayerRole.e_PlayerRole_CF),
        (0.76, 0.10, e_PlayerRole.e_PlayerRole_LM),
        (0.74, -0.12, e_PlayerRole.e_PlayerRole_RM),
    )
    for team, players in (
        (e_Team.e_Left, defenders if at_left_end else attackers),
        (e_Team.e_Right, attackers if at_left_end else defenders),
    ):
        builder.SetTeam(team)
        builder.AddPlayer(-1.0, 0.0, e_PlayerRole.e_PlayerRole_GK)
        for x, y, role in players:
            builder.AddPlayer(x, y, role)
