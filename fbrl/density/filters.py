"""Which passes a density is fitted to: named filters and conditions on top of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from fbrl.checks import check_name
from fbrl.density.coordinates import STATSBOMB_LENGTH
from fbrl.density.passes import Pass, Passes


@dataclass(frozen=True)
class NamedFilter:
    """A filter that has a name: which passes it keeps, and the column that it asks about."""

    description: str
    keeps: Callable[[Pass], bool]
    needs: str | None = None


NOT_SET_PIECES = (None, "Recovery", "Interception")
"""Types of a pass that is not itself a set piece; ``None`` is an ordinary pass."""

FILTERS = {
    "regular-play": NamedFilter(
        "play pattern Regular Play",
        lambda row: row.play_pattern == "Regular Play",
        "play_pattern",
    ),
    "open-play": NamedFilter(
        "not itself a set piece (pass type absent, Recovery or Interception)",
        lambda row: row.pass_type in NOT_SET_PIECES,
        "pass_type",
    ),
    "open-play-strict": NamedFilter(
        "pass type absent", lambda row: row.pass_type is None, "pass_type"
    ),
    "all": NamedFilter("no condition", lambda row: True),
}
DEFAULT_FILTER = "regular-play"

POPULATIONS = {
    "goal-assists": "passes that led to a goal",
    "key-passes": "passes that led to a shot, goals included",
}
DEFAULT_POPULATION = "goal-assists"


@dataclass(frozen=True)
class PassFilter:
    """A population, a named filter and conditions; a pass is kept if all of them hold.

    Attributes:
        name: one of :data:`FILTERS`. ``None`` is regular-play, or all where the source doesn't
            tell the play pattern.
        population: one of :data:`POPULATIONS`.
        exclude_crosses: leave out crosses.
        min_x: the least x of the start on the 120 x 80 pitch.
        min_end_x: the least x of the end.

    Examples:
        >>> from fbrl.density.passes import EVENT_COLUMNS
        >>> corner = Pass(120.0, 0.0, 114.0, 40.0, pass_type="Corner", play_pattern="From Corner")
        >>> through = Pass(90.0, 40.0, 105.0, 38.0, play_pattern="Regular Play")
        >>> passes = Passes([corner, through], EVENT_COLUMNS, "made up")
        >>> PassFilter("open-play")(passes) == [through]
        True
        >>> PassFilter("open-play-strict", min_x=100.0).describe(passes)
        'goal assists; pass type absent; x >= 100'
    """

    name: str | None = None
    population: str = DEFAULT_POPULATION
    exclude_crosses: bool = False
    min_x: float | None = None
    min_end_x: float | None = None

    def __post_init__(self) -> None:
        """Checks the names and the bounds."""
        if self.name is not None:
            check_name("filter", self.name, FILTERS)
        check_name("population", self.population, POPULATIONS)
        for bound, value in (("min_x", self.min_x), ("min_end_x", self.min_end_x)):
            is_number = isinstance(value, (int, float))
            if value is not None and not (is_number and 0 <= value <= STATSBOMB_LENGTH):
                raise ValueError(f"{bound} is {value!r}; it must be in [0, {STATSBOMB_LENGTH:g}].")

    def __call__(self, passes: Passes) -> list[Pass]:
        """The passes that are kept, in their order.

        Raises:
            ValueError: if the source doesn't tell what is asked about.
        """
        named = FILTERS[self.resolved_name(passes)]
        asked = {named.needs: f"the filter {self.name}"} if named.needs else {}
        if self.exclude_crosses:
            asked["cross"] = "exclude_crosses"
        if self.population == "key-passes":
            asked["goal_assist"] = "the population key-passes"
        for column, asking in asked.items():
            if column not in passes.known:
                raise ValueError(
                    f"{passes.origin} does not tell {column}, which {asking} asks about. Add that "
                    "column, ask for something else, or read StatsBomb's events."
                )
        return [row for row in passes.rows if named.keeps(row) and self._meets_conditions(row)]

    def resolved_name(self, passes: Passes) -> str:
        """The named filter that applies to this source."""
        if self.name is not None:
            return self.name
        return DEFAULT_FILTER if "play_pattern" in passes.known else "all"

    def describe(self, passes: Passes) -> str:
        """What is kept, in words, for the metadata of a density."""
        named = FILTERS[self.resolved_name(passes)]
        parts = [self.population.replace("-", " "), named.description]
        if self.exclude_crosses:
            parts.append("no crosses")
        if self.min_x is not None:
            parts.append(f"x >= {self.min_x:g}")
        if self.min_end_x is not None:
            parts.append(f"end x >= {self.min_end_x:g}")
        return "; ".join(parts)

    def _meets_conditions(self, row: Pass) -> bool:
        return (
            (row.goal_assist or self.population == "key-passes")
            and not (self.exclude_crosses and row.cross)
            and (self.min_x is None or row.x >= self.min_x)
            and (self.min_end_x is None or row.end_x >= self.min_end_x)
        )


def count_groups(rows: Iterable[Pass]) -> dict[str, int]:
    """How many passes there are of each competition and season (or file)."""
    return dict(Counter(row.group for row in rows))
