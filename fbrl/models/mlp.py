"""A multilayer perceptron for vector observations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, TypeVar, get_args

import torch
from torch import Tensor, nn

from fbrl.checks import check_count

Activation = Literal["tanh", "relu"]

_ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU}

HIDDEN_GAIN = 2**0.5
"""Gain of the weights of hidden layers, as in OpenAI's Baselines and CleanRL."""

Linear = TypeVar("Linear", bound=nn.Linear)


def orthogonal(linear: Linear, gain: float) -> Linear:
    """Gives a layer orthogonal weights of a gain, and biases of zero; returns it."""
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.zeros_(linear.bias)
    return linear


class MLP(nn.Sequential):
    """Linear layers, each followed by an activation, with orthogonal initialisation.

    The weights' gain is :data:`HIDDEN_GAIN`, and the biases are zero.

    Args:
        observation_shape: of what is read, a vector; (115,) for ``simple115``.
        hidden_sizes: size of each layer; the last one is the number of features.
        activation: ``"relu"`` or ``"tanh"``.
        layer_norm: whether each layer's outputs are normalised before the activation (Ba et al.
            2016), by which the size of the weights matters less for how much an update changes.
        device: where the parameters live.

    Raises:
        ValueError: A size is less than 1, there is no layer, or the activation is unknown.
        TypeError: A size is no integer.

    Examples:
        >>> import torch
        >>> MLP()(torch.zeros(5, 2, 115)).shape
        torch.Size([5, 2, 256])
    """

    def __init__(
        self,
        observation_shape: Sequence[int] = (115,),
        hidden_sizes: Sequence[int] = (256, 256),
        activation: Activation = "relu",
        layer_norm: bool = False,
        device: torch.device | str | None = None,
    ) -> None:
        if activation not in list(_ACTIVATIONS):
            raise ValueError(
                f"activation is {activation!r}, but must be one of {get_args(Activation)}."
            )
        if isinstance(hidden_sizes, str) or not isinstance(hidden_sizes, Sequence):
            raise TypeError(f"hidden_sizes is {hidden_sizes!r}; it must be a list of sizes.")
        if not hidden_sizes:
            raise ValueError(f"hidden_sizes is {hidden_sizes!r}; it must name a layer or more.")
        if len(observation_shape) != 1:
            raise ValueError(
                f"The observation has shape {tuple(observation_shape)}; the network mlp reads "
                "vectors."
            )
        num_inputs = check_count("observation_shape[0]", observation_shape[0])
        for index, size in enumerate(hidden_sizes):
            check_count(f"hidden_sizes[{index}]", size)
        layers: list[nn.Module] = []
        for num_in, num_out in pairwise([num_inputs, *hidden_sizes]):
            linear = nn.Linear(num_in, num_out, device=device)
            layers.append(orthogonal(linear, HIDDEN_GAIN))
            if layer_norm:
                layers.append(nn.LayerNorm(num_out, device=device))
            layers.append(_ACTIVATIONS[activation]())
        super().__init__(*layers)
        self.num_inputs = num_inputs
        self.num_features = hidden_sizes[-1]

    def forward(self, observation: Tensor) -> Tensor:
        """Maps floating point (..., num_inputs) to (..., num_features).

        Raises:
            ValueError: The observation has another size or is not floating point.
        """
        check_vector(observation, self.num_inputs)
        return super().forward(observation)


def check_vector(observation: Tensor, size: int) -> None:
    """Raises ``ValueError`` for what is not floating point of shape (..., size)."""
    if observation.shape[-1:] != (size,) or not observation.is_floating_point():
        raise ValueError(
            f"The observation is {observation.dtype} of shape {tuple(observation.shape)}; it must "
            f"be floating point of shape (..., {size})."
        )
