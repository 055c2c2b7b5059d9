"""The observation ``players`` written from its table, one match and one player at a time."""

from __future__ import annotations

import math
from typing import Any

DIRECTIONS = ["left", "top_left", "top", "top_right", "right", "bottom_right", "bottom"]
DIRECTIONS += ["bottom_left"]
KICKS = ["long_pass", "high_pass", "short_pass", "shot"]
OTHERS = ["sprint", "release_direction", "release_sprint", "sliding", "dribble", "release_dribble"]
ACTIONS = ["idle", *DIRECTIONS, *KICKS, *OTHERS]
MODES = ["normal", "kick_off", "goal_kick", "free_kick", "corner", "throw_in", "penalty"]
X, Y = 54.4, 83.6


def metres(point) -> tuple[float, float]:
    return float(point[0]) * X, float(point[1]) * Y


def players_by_name(raw: dict[str, Any], memory: tuple[int, int, int]) -> dict[str, float]:
    """The numbers of one match by their names, in any order."""
    active = int(raw["active"])
    me = metres(raw["left_team"][active] if active >= 0 else raw["ball"])
    ball = metres(raw["ball"])
    line = offside_line(raw)
    numbers = {
        **held_and_done(raw, memory),
        **own(raw, active, me),
        **of_the_ball(raw, ball, me),
        **goals(me),
        "offside_line": (line - me[0]) / 25,
        "score_difference": max(-3, min(3, int(raw["score"][0]) - int(raw["score"][1]))) / 3,
        "steps_left": min(int(raw["steps_left"]), 400) / 400,
        "match_left": int(raw["steps_left"]) / 3000,
    }
    for index, name in enumerate(MODES):
        numbers[f"mode_{name}"] = float(raw["game_mode"] == index)
    for team, who, slots in ((0, "mate", 10), (1, "opponent", 11)):
        rows = [
            player(raw, team, index, me, line)
            for index in range(11)
            if raw[("left", "right")[team] + "_team_active"][index] and (team, index) != (0, active)
        ]
        rows.sort(key=lambda row: row["distance"])
        absent = dict.fromkeys(player(raw, team, 0, me, line), 0.0)
        for slot in range(slots):
            row = rows[slot] if slot < len(rows) else absent
            numbers |= {f"{who}_{slot + 1}_{name}": value for name, value in row.items()}
    return numbers


def held_and_done(raw, memory) -> dict[str, float]:
    last, kick, steps = memory
    held = [*DIRECTIONS, "sprint", "dribble"]
    return {
        **{f"held_{name}": float(raw["sticky_actions"][i]) for i, name in enumerate(held)},
        **{f"last_{name}": float(last == i) for i, name in enumerate(ACTIONS)},
        **{f"last_kick_{ACTIONS[i]}": float(kick == i) for i in range(9, 13)},
        "steps_since_kick": min(steps, 20) / 20,
        "kick_may_wait": float(steps <= 20),
    }


def own(raw, active, me) -> dict[str, float]:
    vx, vy = metres(raw["left_team_direction"][active]) if active >= 0 else (0.0, 0.0)
    return {
        "own_velocity_x": vx * 10 / 5,
        "own_velocity_y": vy * 10 / 5,
        "own_tired": float(raw["left_team_tired_factor"][active]) if active >= 0 else 0.0,
        "own_is_keeper": float(active >= 0 and raw["left_team_roles"][active] == 0),
        "own_x": me[0] / 25,
        "own_y": me[1] / 25,
        "is_controlled": float(active >= 0),
        "is_designated": float(active >= 0 and active == raw["designated"]),
    }


def of_the_ball(raw, ball, me) -> dict[str, float]:
    owner, x, y = int(raw["ball_owned_team"]), ball[0] - me[0], ball[1] - me[1]
    is_own = owner == 0 and raw["ball_owned_player"] == raw["active"]
    vx, vy = metres(raw["ball_direction"])
    return {
        "ball_pitch_x": ball[0] / 25,
        "ball_pitch_y": ball[1] / 25,
        "ball_x": x / 25,
        "ball_y": y / 25,
        "ball_distance": math.hypot(x, y) / 25,
        "ball_closeness": 1 / (1 + math.hypot(x, y)),
        "ball_height": float(raw["ball"][2]) / 2,
        "ball_velocity_x": vx * 10 / 10,
        "ball_velocity_y": vy * 10 / 10,
        "ball_velocity_z": float(raw["ball_direction"][2]) * 10 / 10,
        "ball_is_free": float(owner == -1),
        "ball_is_own": float(is_own),
        "ball_is_mates": float(owner == 0 and not is_own),
        "ball_is_opponents": float(owner == 1),
    }


def goals(me) -> dict[str, float]:
    x, y = X - me[0], -me[1]
    distance = math.hypot(x, y)
    upper = math.atan2(-0.044 * Y - me[1], x)
    lower = math.atan2(0.044 * Y - me[1], x)
    # Seen from behind the line the lower post comes first, and the angle goes the other way round.
    opening = (lower - upper + math.pi) % (2 * math.pi) - math.pi
    return {
        "goal_x": x / 25,
        "goal_y": y / 25,
        "goal_direction_x": x / max(distance, 1e-6),
        "goal_direction_y": y / max(distance, 1e-6),
        "goal_opening": opening / 0.25,
        "goal_distance": distance / 25,
        "own_goal_distance": math.hypot(X + me[0], me[1]) / 25,
    }


def offside_line(raw) -> float:
    opponents = [
        metres(place)[0]
        for place, is_there in zip(raw["right_team"], raw["right_team_active"], strict=True)
        if is_there
    ]
    last_but_one = sorted(opponents)[-2] if len(opponents) > 1 else 0.0
    return max(0.0, last_but_one, metres(raw["ball"])[0])


def player(raw, team, index, me, line) -> dict[str, float]:
    side = ("left_team", "right_team")[team]
    place, velocity = metres(raw[side][index]), metres(raw[f"{side}_direction"][index])
    x, y = place[0] - me[0], place[1] - me[1]
    has_ball = raw["ball_owned_team"] == team and raw["ball_owned_player"] == index
    row = {
        "is_there": 1.0,
        "x": x / 25,
        "y": y / 25,
        "distance": math.hypot(x, y) / 25,
        "velocity_x": velocity[0] * 10 / 5,
        "velocity_y": velocity[1] * 10 / 5,
        "tired": float(raw[f"{side}_tired_factor"][index]),
        "is_keeper": float(raw[f"{side}_roles"][index] == 0),
        "has_ball": float(has_ball),
    }
    return row | ({"is_offside": float(place[0] > line)} if team == 0 else {})
