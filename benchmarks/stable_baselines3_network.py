"""fbrl's networks as features extractors of Stable-Baselines3."""

from __future__ import annotations

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch.nn import functional

from fbrl.models.impala import ImpalaCNN
from fbrl.models.mlp import MLP


class ImpalaFeatures(BaseFeaturesExtractor):
    """:class:`fbrl.models.impala.ImpalaCNN` on dense planes, in its fast memory layout."""

    def __init__(self, observation_space: spaces.Box) -> None:
        network = ImpalaCNN()
        super().__init__(observation_space, network.num_features)
        self.network = network

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        """Maps planes, which Stable-Baselines3 has divided by 255, to features."""
        network = self.network
        planes = planes.contiguous(memory_format=torch.channels_last)
        features = functional.relu(network.stages(planes), inplace=True).flatten(1)
        return functional.relu(network.linear(features), inplace=True)


class MLPFeatures(BaseFeaturesExtractor):
    """:class:`fbrl.models.mlp.MLP` with two layers of 256."""

    def __init__(self, observation_space: spaces.Box) -> None:
        network = MLP((observation_space.shape[-1],), (256, 256), "relu")
        super().__init__(observation_space, network.num_features)
        self.network = network

    def forward(self, vector: torch.Tensor) -> torch.Tensor:
        """Maps vectors to features."""
        return self.network(vector.flatten(1))
