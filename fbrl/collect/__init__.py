"""How experience is collected: the only place that knows the arrangements there are."""

from fbrl.collect.ahead_collector import AheadCollector
from fbrl.collect.collector import BatchCollector, RolloutCollector
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.collect.match_collector import MatchCollector

__all__ = [
    "AheadCollector",
    "BatchCollector",
    "EpisodeBookkeeping",
    "MatchCollector",
    "RolloutCollector",
]
