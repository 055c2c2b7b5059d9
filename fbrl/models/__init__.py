"""Neural networks: trunks for the observations, and the actor-critic on top of them."""

from fbrl.models.actor_critic import ActorCritic, CollectionPolicy, build_actor_critic
from fbrl.models.impala import ImpalaCNN
from fbrl.models.mlp import MLP
from fbrl.models.player_set import PlayerSet

__all__ = [
    "MLP",
    "ActorCritic",
    "CollectionPolicy",
    "ImpalaCNN",
    "PlayerSet",
    "build_actor_critic",
]
