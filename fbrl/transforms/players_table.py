"""The numbers of the observation ``players``: their names, order and meaning."""

from __future__ import annotations

from fbrl.envs.actions import ACTION_NAMES

NUM_MATES = 10
NUM_OPPONENTS = 11

_GAME_MODES = ("normal", "kick_off", "goal_kick", "free_kick", "corner", "throw_in", "penalty")

SINGLE_FEATURES: dict[str, str] = {
    **{
        f"held_{name}": f"1 while {name} is held"
        for name in (*ACTION_NAMES[1:9], "sprint", "dribble")
    },
    **{f"last_{name}": f"1 if the last action was {name}" for name in ACTION_NAMES},
    **{f"last_kick_{name}": f"1 if the last kick was a {name}" for name in ACTION_NAMES[9:13]},
    **{f"mode_{name}": f"1 in the game mode {name.replace('_', ' ')}" for name in _GAME_MODES},
    "ball_is_free": "1 if nobody has the ball",
    "ball_is_own": "1 if the controlled player has it",
    "ball_is_mates": "1 if a team-mate has it",
    "ball_is_opponents": "1 if an opponent has it",
    "own_velocity_x": "of the controlled player / 5 m/s",
    "own_velocity_y": "likewise",
    "own_tired": "tiredness, 0 to 1",
    "own_is_keeper": "1 if the controlled player is the keeper",
    "own_x": "from the centre of the pitch to the player / 25 m",
    "own_y": "likewise",
    "ball_pitch_x": "from the centre of the pitch to the ball / 25 m",
    "ball_pitch_y": "likewise",
    "ball_x": "from the player to the ball / 25 m",
    "ball_y": "likewise",
    "ball_distance": "likewise",
    "ball_closeness": "1 / (1 + this distance in metres)",
    "ball_height": "/ 2 m",
    "ball_velocity_x": "/ 10 m/s",
    "ball_velocity_y": "likewise",
    "ball_velocity_z": "likewise",
    "goal_x": "from the player to the middle of their goal / 25 m",
    "goal_y": "likewise",
    "goal_direction_x": "cosine of the direction to it",
    "goal_direction_y": "sine of it",
    "goal_opening": "angle between its posts / 0.25 radians; below 0 behind the goal line",
    "goal_distance": "from the player to the middle of their goal / 25 m",
    "own_goal_distance": "to the middle of our goal / 25 m",
    "steps_since_kick": "steps since the last kick was chosen / 20, at most 1; 1 for none yet",
    "kick_may_wait": "1 for 20 steps after one was chosen: it may still wait for the ball",
    "is_controlled": "1 where a player is controlled",
    "is_designated": "1 if the team's play is about that player",
    "offside_line": "from the player to the offside line, along x / 25 m",
    "score_difference": "goals for minus against / 3, from -1 to 1",
    "steps_left": "steps until the time limit / 400, at most 1",
    "match_left": "steps until the time limit / 3000",
}
"""What there is once, with its meaning, in order."""

PLAYER_FEATURES: dict[str, str] = {
    "is_there": "1 if there is this player",
    "x": "from the controlled player / 25 m",
    "y": "likewise",
    "distance": "likewise",
    "velocity_x": "/ 5 m/s",
    "velocity_y": "likewise",
    "tired": "tiredness, 0 to 1",
    "is_keeper": "1 for the keeper",
    "has_ball": "1 if the player has the ball",
    "is_offside": "team-mates only: 1 beyond the offside line, also in scenarios without that rule",
}
"""What there is for each player, with its meaning, in order; for opponents all but the last."""

_MATE_FEATURES = list(PLAYER_FEATURES)
_OPPONENT_FEATURES = _MATE_FEATURES[:-1]

PLAYERS_FEATURES: dict[str, str] = {
    **SINGLE_FEATURES,
    **{
        f"mate_{number}_{name}": PLAYER_FEATURES[name]
        for number in range(1, NUM_MATES + 1)
        for name in _MATE_FEATURES
    },
    **{
        f"opponent_{number}_{name}": PLAYER_FEATURES[name]
        for number in range(1, NUM_OPPONENTS + 1)
        for name in _OPPONENT_FEATURES
    },
}
"""The name and the meaning of each number of ``players``, in order."""

NUM_FEATURES = len(PLAYERS_FEATURES)

MATES = slice(len(SINGLE_FEATURES), len(SINGLE_FEATURES) + NUM_MATES * len(_MATE_FEATURES))
"""The columns of the team-mates."""

OPPONENTS = slice(MATES.stop, NUM_FEATURES)
"""The columns of the opponents."""
