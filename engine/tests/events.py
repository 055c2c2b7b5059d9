"""What happened in an episode, seen from outside: so that it is known what equal matches prove."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from observation import Numbers

_SET_PIECES = {
    2: "goal_kicks",
    3: "free_kicks",
    4: "corners",
    5: "throw_ins",
    6: "penalties",
}
EVENTS = (
    "goals_for",
    "goals_against",
    "kick_offs",
    *_SET_PIECES.values(),
    "offsides",
    "no_offsides",
    "half_times",
    "yellow_cards",
    "sent_off",
    "control_changes",
    "forced_actions",
)


class EventCounter:
    """Counts the events of an episode from what is read after each step of the engine.

    The engine tells of no offside: a free kick follows it as it follows a foul. Only its state has
    the foul, so that ``is_offside`` looks there; at every other free kick alone, so that matches
    in which no state is ever taken are compared as well: ``offsides`` and ``no_offsides`` are half
    of them. A player is sent off for his second yellow card, which the engine shows only by that.

    Args:
        is_offside: Whether the free kick that has just been given is for offside.
    """

    def __init__(self, is_offside: Callable[[], bool]) -> None:
        self.counts: Counter[str] = Counter()
        self._is_offside = is_offside
        self._before: Numbers | None = None
        self._was_in_play = False
        # Each episode begins with a kick-off, which is no second half.
        self._kick_off_is_due = True

    def see(self, numbers: Numbers, is_in_play: bool) -> None:
        """Counts what has changed since the last step; waiting for play counts as a step."""
        before, self._before = self._before, numbers
        was_in_play, self._was_in_play = self._was_in_play, is_in_play
        mode = int(numbers["game_mode"][0])
        if before is not None:
            self._count_changes(before, numbers)
            if mode in _SET_PIECES and before["game_mode"][0] != mode:
                self._count_set_piece(_SET_PIECES[mode])
        # A kick-off is over before it is seen: all other set pieces show in the game's mode.
        if is_in_play and not was_in_play and mode not in _SET_PIECES:
            self.counts["kick_offs"] += 1
            self.counts["half_times"] += not self._kick_off_is_due
            self._kick_off_is_due = False

    def _count_changes(self, before: Numbers, numbers: Numbers) -> None:
        for goals, old, new in zip(
            ("goals_for", "goals_against"),
            before["score"],
            numbers["score"],
            strict=True,
        ):
            self.counts[goals] += int(new - old)
            self._kick_off_is_due |= new != old
        for team in ("left_team", "right_team"):
            cards = zip(
                before[f"{team}_yellow_card"],
                numbers[f"{team}_yellow_card"],
                strict=True,
            )
            self.counts["yellow_cards"] += sum(new > old for old, new in cards)
            active = zip(before[f"{team}_active"], numbers[f"{team}_active"], strict=True)
            self.counts["sent_off"] += sum(new < old for old, new in active)
        self.counts["control_changes"] += before["active"] != numbers["active"]

    def _count_set_piece(self, name: str) -> None:
        self.counts[name] += 1
        if name == "free_kicks" and self.counts[name] % 2:
            self.counts["offsides" if self._is_offside() else "no_offsides"] += 1
