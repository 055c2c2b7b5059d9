"""What the actions are called: gfootball's default action set, in the order of its indices."""

from __future__ import annotations

ACTION_NAMES = (
    "idle",
    "left",
    "top_left",
    "top",
    "top_right",
    "right",
    "bottom_right",
    "bottom",
    "bottom_left",
    "long_pass",
    "high_pass",
    "short_pass",
    "shot",
    "sprint",
    "release_direction",
    "release_sprint",
    "sliding",
    "dribble",
    "release_dribble",
)
"""Names of the 19 actions; attack is towards the right, and the top is where y is negative."""
