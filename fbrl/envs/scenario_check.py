"""What a scenario file may ask of the engine, which takes anything and then hangs, or worse."""

from __future__ import annotations

from typing import Any

from fbrl.envs.observation import MAX_DURATION, MAX_PLAYERS

FARTHEST = 100.0
"""Largest coordinate of a player or the ball, in pitch units; far beyond it they become NaN."""


class ScenarioError(ValueError):
    """Raised for a scenario's file that fails, or asks for what the engine can't play."""


def check_scenario_config(scenario: str, config: Any) -> None:
    """Refuses a configuration that the engine can't play.

    Args:
        scenario: Its name, for the message.
        config: What gfootball's scenario builder made of its file.

    Raises:
        ScenarioError: A team has not 1 to 11 players, or its first one is no keeper; a coordinate
            or a difficulty is out of range; or there is no time to play.
    """
    for side in ("left", "right"):
        _check_team(scenario, side, list(getattr(config, f"{side}_team")))
        difficulty = getattr(config, f"{side}_team_difficulty")
        if not 0 <= difficulty <= 1:
            _refuse(scenario, f"{side}_team_difficulty is {difficulty:g}", "in [0, 1]")
    _check_position(scenario, "the ball", config.ball_position)
    if not 1 <= config.game_duration <= MAX_DURATION:
        allowed = f"1 to {MAX_DURATION:,} steps"
        _refuse(scenario, f"game_duration is {config.game_duration}", allowed)


def _check_team(scenario: str, side: str, team: list[Any]) -> None:
    if not 1 <= len(team) <= MAX_PLAYERS:
        _refuse(scenario, f"the {side} team has {len(team)} players", f"1 to {MAX_PLAYERS}")
    # The engine takes the first one for the keeper, and waits for it forever when the ball is out.
    role = team[0].role.name.removeprefix("e_PlayerRole_")
    if role != "GK":
        _refuse(
            scenario,
            f"the {side} team's first player has the role {role}",
            "the keeper (e_PlayerRole_GK): add it before the others, far away if it shall not "
            "matter",
        )
    for number, player in enumerate(team):
        _check_position(scenario, f"player {number} of the {side} team", player.position)


def _check_position(scenario: str, what: str, position: Any) -> None:
    x, y = position[0], position[1]
    if not (abs(x) <= FARTHEST and abs(y) <= FARTHEST):  # NaN neither
        _refuse(
            scenario,
            f"{what} is at ({x:g}, {y:g})",
            f"within {FARTHEST:g}; the pitch is [-1, 1] x [-0.42, 0.42]",
        )


def _refuse(scenario: str, what: str, allowed: str) -> None:
    raise ScenarioError(
        f"The scenario {scenario!r} can't be played: {what}; it must be {allowed}. "
        "Correct its file."
    )
