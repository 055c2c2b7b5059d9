"""How experience is collected: the only place that knows the arrangements there are."""

from fbrl.collect.collector import (
    AheadCollector,
    BatchCollector,
    EpisodeBookkeeping,
    RolloutCollector,
)
from fbrl.collect.match_collector import MatchCollector

__all__ = [
    "AheadCollector",
    "BatchCollector",
    "EpisodeBookkeeping",
    "MatchCollector",
    "RolloutCollector",
]
