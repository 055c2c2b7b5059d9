"""The passes of a recorded match."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbrl.watch.recording import MatchRecording


@dataclass(frozen=True)
class CompletedPass:
    """A ball that went from one player of a team to another.

    Attributes:
        team: 0 for the left team, 1 for the right one.
        received_at: Index of the first state in which the receiver has the ball.
        start: Where the passer had the ball last, x and y in pitch units.
        end: Where the receiver has it first.
    """

    team: int
    received_at: int
    start: np.ndarray
    end: np.ndarray


def completed_passes(recording: MatchRecording) -> list[CompletedPass]:
    """The passes in play, of either team, in their order."""
    observations = recording.observations
    ball = observations["ball"][:, :2]
    owners = zip(
        observations["ball_owned_team"].tolist(),
        observations["ball_owned_player"].tolist(),
        observations["game_mode"].tolist(),
        strict=True,
    )
    passes = []
    carrier: tuple[int, int] | None = None
    carried_at = 0
    for index, (team, player, game_mode) in enumerate(owners):
        if game_mode != 0:
            carrier = None
        elif team != -1:
            if carrier is not None and carrier[0] == team and carrier[1] != player:
                passes.append(CompletedPass(team, index, ball[carried_at], ball[index]))
            carrier, carried_at = (team, player), index
    return passes
