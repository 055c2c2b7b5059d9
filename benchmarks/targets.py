"""What fbrl sets itself as targets, and whether a run met them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from benchmarks import sections
from benchmarks.measure_time_shares import REWARD_OF_COLLECTION
from benchmarks.results import NOT_MEASURED, SectionResults, Summary, format_summary, markdown_table
from benchmarks.sections import COUNTERATTACK, FRAMES, FULL_MATCH, STEPS, THREE_VS_ONE


@dataclass(frozen=True)
class Target:
    """A bound on a figure of a contestant, or on its ratio to a peer's."""

    what: str
    section: str
    case: str
    name: str
    figure: str
    at_least: float | None = None
    at_most: float | None = None
    peer: str | None = None
    unit: str = ""

    @property
    def bound(self) -> str:
        """The limit in words."""
        if self.at_least is not None:
            return f"at least {self.at_least:g}{self.unit}"
        return f"at most {self.at_most:g}{self.unit}"

    def measured(self, results: Mapping[str, SectionResults]) -> Summary | None:
        """What the figure came to; None where it was not measured."""
        if self.section not in results:
            return None
        return results[self.section].summary(self.case, self.name, self.figure, self.peer)

    def is_met_by(self, summary: Summary) -> bool:
        """Whether the median keeps the bound."""
        if self.at_least is not None:
            return summary.median >= self.at_least
        return self.at_most is not None and summary.median <= self.at_most


def targets() -> Iterator[Target]:
    """All targets."""
    for case in (THREE_VS_ONE, COUNTERATTACK):
        yield Target(
            "steps per second and core: FootballEnv with the keys of the mini map against "
            "gfootball's own environment with its SMM wrapper",
            *("environment", case, sections.MINIMAP, STEPS),
            at_least=5.0,
            peer=sections.SMM,
        )
    for case in (THREE_VS_ONE, COUNTERATTACK, FULL_MATCH):
        yield Target(
            "frames per second on all cores: collection with the MLP against the bare engine of "
            "the same build",
            *("engine", case, sections.COLLECTION, FRAMES),
            at_least=0.92,
            peer=sections.ENGINE,
        )
    for case, _, _ in sections.MANY_CORES:
        yield Target(
            "collection's share of engines that sleep, a thread for each core",
            *("many_cores", case, sections.FBRL, sections.SHARE),
            at_least=0.85 if case.endswith("a GPU") else 0.9,
        )
    for network, scenario in itertools.product(("cnn", "mlp"), (THREE_VS_ONE, COUNTERATTACK)):
        case = sections.training_case(scenario, network)
        yield Target(
            "frames per second of a training against Stable-Baselines3 on gfootball's own "
            "environment",
            *("training", case, sections.FBRL, FRAMES),
            at_least=2.7 if network == "cnn" else 5.0,
            peer=sections.PEER,
        )
        if network == "cnn":
            yield Target(
                "the same with fbrl's CNN in bfloat16, the peer's in float32",
                *("training", case, sections.FBRL + sections.IN_BFLOAT16, FRAMES),
                at_least=2.7,
                peer=sections.PEER,
            )
    for network in ("cnn", "mlp"):
        case = sections.training_case(THREE_VS_ONE, network)
        yield Target(
            "time of the reward transform, of that of collection",
            *("time_shares", case, sections.FBRL, REWARD_OF_COLLECTION),
            at_most=2.0,
            unit=" %",
        )
    yield Target(
        "bytes of a stored frame's observation, dense against compact",
        *("memory", THREE_VS_ONE, sections.STORED_FRAME, "planes_per_cells"),
        at_least=100,
    )
    yield Target(
        "peak memory of fbrl-train with 8 matches and the CNN",
        *("memory", THREE_VS_ONE, sections.TRAINING_MEMORY, "megabytes"),
        at_most=1200,
        unit=" MB",
    )
    yield Target(
        "the same with the CNN in bfloat16",
        *("memory", THREE_VS_ONE, sections.TRAINING_MEMORY + sections.IN_BFLOAT16, "megabytes"),
        at_most=1200,
        unit=" MB",
    )


def targets_table(results: Mapping[str, SectionResults]) -> str:
    """All targets with what was measured, and whether the median meets them."""
    rows = []
    for target in targets():
        summary = target.measured(results)
        met = NOT_MEASURED if summary is None else "yes" if target.is_met_by(summary) else "**no**"
        measured = format_summary(summary, target.unit)
        rows.append([target.what, target.case, target.bound, measured, met])
    return markdown_table(["what", "case", "target", "measured", "met"], rows)
