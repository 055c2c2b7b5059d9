"""All that an engine tells of a match, as numbers in a fixed order."""

from __future__ import annotations

from array import array
from itertools import chain
from typing import Any

Numbers = dict[str, list[float]]

_TEAM_KEYS = ("", "_direction", "_tired_factor", "_yellow_card", "_active", "_roles")
KEYS = (
    *("ball", "ball_direction", "ball_rotation"),
    *(f"{team}{key}" for team in ("left_team", "right_team") for key in _TEAM_KEYS),
    *("active", "designated", "ball_owned_team", "ball_owned_player", "game_mode", "score"),
    *("steps_left", "sticky_actions"),
)
"""Names of the numbers of an observation, in their order."""


def bits(numbers: Numbers) -> bytes:
    """The bits of numbers: the engine's are of single precision, which double precision holds."""
    return array("d", chain.from_iterable(numbers.values())).tobytes()


def _vector(vector: Any) -> list[float]:
    return [vector[0], vector[1], vector[2]]


def observed_numbers(engine: Any, info: Any, sticky_actions: list[Any], duration: int) -> Numbers:
    """The numbers of every key of an observation, with the players that there are."""
    numbers: Numbers = {
        "ball": _vector(info.ball_position),
        "ball_direction": _vector(info.ball_direction),
        "ball_rotation": _vector(info.ball_rotation),
    }
    for team in ("left_team", "right_team"):
        players = getattr(info, team)
        players = [players[index] for index in range(len(players))]
        positions = [player.position for player in players]
        directions = [player.direction for player in players]
        numbers[team] = [vector[axis] for vector in positions for axis in (0, 1)]
        numbers[f"{team}_direction"] = [vector[axis] for vector in directions for axis in (0, 1)]
        numbers[f"{team}_tired_factor"] = [player.tired_factor for player in players]
        numbers[f"{team}_yellow_card"] = [player.has_card for player in players]
        numbers[f"{team}_active"] = [player.is_active for player in players]
        numbers[f"{team}_roles"] = [player.role for player in players]
    left = info.left_team
    numbers["active"] = [info.left_controllers[0].controlled_player]
    numbers["designated"] = [
        next((index for index in range(len(left)) if left[index].designated_player), -1)
    ]
    numbers["ball_owned_team"] = [info.ball_owned_team]
    numbers["ball_owned_player"] = [info.ball_owned_player]
    numbers["game_mode"] = [int(info.game_mode)]
    numbers["score"] = [info.left_goals, info.right_goals]
    numbers["steps_left"] = [duration - info.step]
    numbers["sticky_actions"] = [
        engine.sticky_action_state(action, True, 0) for action in sticky_actions
    ]
    return numbers


def other_numbers(
    engine: Any, info: Any, sticky_actions: list[Any], agents: list[tuple[bool, int]]
) -> Numbers:
    """What the engine tells besides, which is in no observation."""
    numbers: Numbers = {"is_in_play": [info.is_in_play], "step": [info.step]}
    for team in ("left_team", "right_team"):
        players = getattr(info, team)
        players = [players[index] for index in range(len(players))]
        numbers[f"{team}_height"] = [
            vector[2] for player in players for vector in (player.position, player.direction)
        ]
        numbers[f"{team}_designated"] = [player.designated_player for player in players]
    for side in ("left_controllers", "right_controllers"):
        controllers = getattr(info, side)
        numbers[side] = [controllers[index].controlled_player for index in range(len(controllers))]
    numbers["agents_sticky_actions"] = [
        engine.sticky_action_state(action, is_left, player)
        for is_left, player in agents[1:]
        for action in sticky_actions
    ]
    return numbers
