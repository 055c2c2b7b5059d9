"""A network of your own: fbrl-train SCENARIO --network attention:Transformer."""

from collections.abc import Sequence

from torch import Tensor, nn


class Transformer(nn.Module):
    """Reads a vector as tokens of five numbers each, which look at each other.

    Args:
        observation_shape: That of simple115.
        width: Numbers of a token.
        num_layers: How often they look.
    """

    def __init__(self, observation_shape: Sequence[int], width: int = 64, num_layers: int = 1):
        super().__init__()
        self.embed = nn.Linear(5, width)
        layer = nn.TransformerEncoderLayer(width, 4, 2 * width, dropout=0.0, batch_first=True)
        self.look = nn.TransformerEncoder(layer, num_layers, enable_nested_tensor=False)
        self.num_features = width

    def forward(self, observation: Tensor) -> Tensor:
        """Maps (..., 115) to (..., width)."""
        tokens = self.embed(observation.reshape(-1, observation.shape[-1] // 5, 5))
        return self.look(tokens).mean(1).reshape(*observation.shape[:-1], -1)
