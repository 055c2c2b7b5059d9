"""A foul that is written into a state, since what follows a grave one happens too rarely."""

from __future__ import annotations

import struct

from state_layout import fields

AFTER_STEPS = 40
"""Of an episode; by then the game is in play."""


def with_foul(state: bytes, kind: int) -> bytes:
    """The state with a foul in a penalty area that the referee has yet to deal with.

    Args:
        state: Of a match that is in play.
        kind: 2 for a yellow card, the player's second, 3 for a red one: he is sent off either way.

    Returns:
        A state of the same length.
    """
    places = {field.name: field for field in fields(state)}

    def read(name: str) -> int:
        return int.from_bytes(state[places[name].start : places[name].stop], "little")

    # Pointers to players are numbers among those of the team that is processed first and those of
    # the other one. The first outfield player of each is meant.
    victim = 1
    fouling = 1 + (read("right_players") if read("first_team") else read("left_players"))
    # The victim attacks this goal.
    side = -1 if read("first_team") else 1
    values = {
        f"players[{fouling}].cards": struct.pack("<i", 1),
        "referee.foulPlayer": struct.pack("<i", fouling),
        "referee.foulVictim": struct.pack("<i", victim),
        "referee.foulType": struct.pack("<i", kind),
        "referee.advantage": bytes(1),
        "referee.foulTime": struct.pack("<Q", read("actualTime_ms")),
        "referee.foulPosition": struct.pack("<3f", 45.0 * side, 3.0, 0.0),
        "referee.hasBeenProcessed": bytes(1),
    }
    changed = bytearray(state)
    for name, value in values.items():
        changed[places[name].start : places[name].stop] = value
    return bytes(changed)
