"""How experience is collected: the only place that knows the arrangements there are."""

from fbrl.collect.ahead_collector import AheadCollector
from fbrl.collect.collection_env import make_collection_env
from fbrl.collect.collector import BatchCollector, RolloutCollector
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping

__all__ = [
    "AheadCollector",
    "BatchCollector",
    "EpisodeBookkeeping",
    "RolloutCollector",
    "make_collection_env",
]
