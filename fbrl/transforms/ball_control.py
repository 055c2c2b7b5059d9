"""Who has the ball: the questions about a match that rewards and statistics share."""

from __future__ import annotations

import torch
from torch import Tensor

Observation = dict[str, Tensor]
"""Observation entries by their usual names, each of the match's leading shape and its own."""

NOBODY = -1
"""In the place of a player's index."""


def in_control(observation: Observation) -> Tensor:
    """Whether the controlled player has the ball: active(s) of the thesis, shape (...)."""
    own_player = observation["ball_owned_player"] == observation["active"]
    return (observation["ball_owned_team"] == 0) & own_player


def ball_lost(observation: Observation) -> Tensor:
    """Whether the other team has the ball, or the game has stopped, shape (...)."""
    return (observation["game_mode"] != 0) | (observation["ball_owned_team"] == 1)


def last_carrier(carrier: Tensor, active: Tensor, control: Tensor, lost: Tensor) -> Tensor:
    """The controlled player who had the ball last since it was lost, from the one before a step."""
    return torch.where(control, active, carrier).masked_fill(lost, NOBODY)
