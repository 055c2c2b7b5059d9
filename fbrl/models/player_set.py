"""A network that treats the players of the observation ``players`` as two sets."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from fbrl.checks import check_count
from fbrl.models.mlp import HIDDEN_GAIN, MLP, Activation, check_vector, orthogonal
from fbrl.transforms.players_table import (
    MATES,
    NUM_FEATURES,
    NUM_MATES,
    NUM_OPPONENTS,
    OPPONENTS,
    PLAYER_FEATURES,
)


class PlayerSet(nn.Module):
    """One perceptron for every team-mate and one for every opponent, pooled, then a perceptron.

    What is learned of one player holds for all of its team, whatever its place in the order. Each
    player's embedding, a layer of which also sees the numbers that there are once, is pooled over
    those who are there, by their maximum and their mean (Zaheer et al. 2017, deep sets). The
    pooled embeddings and the numbers that there are once go into an :class:`MLP`.

    Args:
        observation_shape: of what is read; only (274,), that of ``players``.
        embedding_size: numbers of a player's embedding.
        hidden_sizes: of the last perceptron, as are the other arguments, see :class:`MLP`.
        activation: likewise.
        layer_norm: likewise.
        device: where the parameters live.

    Raises:
        ValueError: A size is less than 1, there is no layer, or the activation is unknown.
        TypeError: A size is no integer.

    Examples:
        >>> import torch
        >>> PlayerSet()(torch.zeros(5, 2, 274)).shape
        torch.Size([5, 2, 256])
    """

    def __init__(
        self,
        observation_shape: Sequence[int] = (NUM_FEATURES,),
        embedding_size: int = 32,
        hidden_sizes: Sequence[int] = (256, 256),
        activation: Activation = "relu",
        layer_norm: bool = False,
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        if tuple(observation_shape) != (NUM_FEATURES,):
            raise ValueError(
                f"The observation has shape {tuple(observation_shape)}; the network player_set "
                f"reads players, of shape ({NUM_FEATURES},)."
            )
        size = check_count("embedding_size", embedding_size)
        num_once, per_mate = MATES.start, len(PLAYER_FEATURES)
        self.mates = _PlayerEmbedding(per_mate, num_once, size, device)
        self.opponents = _PlayerEmbedding(per_mate - 1, num_once, size, device)
        inputs = (num_once + 4 * size,)
        self.perceptron = MLP(inputs, hidden_sizes, activation, layer_norm, device)
        self.num_features = self.perceptron.num_features

    def forward(self, players: Tensor) -> Tensor:
        """Maps floating point (..., 274) to (..., num_features).

        Raises:
            ValueError: The observation has another size or is not floating point.
        """
        check_vector(players, NUM_FEATURES)
        once = players[..., : MATES.start]
        mates = players[..., MATES].unflatten(-1, (NUM_MATES, -1))
        opponents = players[..., OPPONENTS].unflatten(-1, (NUM_OPPONENTS, -1))
        pooled = [once, self.mates(mates, once), self.opponents(opponents, once)]
        return self.perceptron(torch.cat(pooled, -1))


class _PlayerEmbedding(nn.Module):
    """Embeds the players of a team and pools them: their maximum and their mean."""

    def __init__(
        self, num_inputs: int, num_once: int, size: int, device: torch.device | str | None
    ) -> None:
        super().__init__()
        self.of_player = orthogonal(nn.Linear(num_inputs, size, device=device), HIDDEN_GAIN)
        self.of_match = orthogonal(nn.Linear(num_once, size, device=device), HIDDEN_GAIN)
        self.embedding = orthogonal(nn.Linear(size, size, device=device), HIDDEN_GAIN)

    def forward(self, players: Tensor, once: Tensor) -> Tensor:
        hidden = self.of_player(players) + self.of_match(once).unsqueeze(-2)
        embedded = self.embedding(hidden.relu_()).relu_()
        # What is embedded is not negative, so that who isn't there never is the maximum.
        embedded = embedded * players[..., :1]
        mean = embedded.sum(-2) / players[..., 0].sum(-1, keepdim=True).clamp(min=1)
        # The gradient of ``amax``, which shares it out among equals, takes several times as long.
        return torch.cat([embedded.max(-2).values, mean], -1)
