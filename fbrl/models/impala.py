"""The convolutional network of the Google Research Football paper."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, get_args

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from fbrl.checks import check_count
from fbrl.transforms.minimap_grid import (
    CELLS_PER_FRAME,
    SMM_HEIGHT,
    SMM_LAYERS,
    SMM_WIDTH,
    cells_to_planes,
)

Precision = Literal["float32", "bfloat16"]


class ImpalaCNN(nn.Module):
    """gfootball's ``gfootball_impala_cnn``: from pictures, such as stacked mini maps, to features.

    Four stages of 16, 32, 32 and 32 channels, each a 3x3 convolution without activation, a 3x3
    max-pooling of stride 2 and two residual blocks; then a ReLU, and a linear layer with ReLU.
    Sizes, padding and initialisation follow the original in TensorFlow and Sonnet: weights from a
    normal distribution of standard deviation ``1 / sqrt(fan_in)`` truncated at two of them, and
    biases of zero.

    Minimap cells are drawn as planes first, on the device. In bfloat16, PyTorch's mixed precision,
    parameters and features stay what they are and what lies between takes half the memory; on
    CPUs with AMX and on GPUs it takes about half the time, on CPUs without AMX more.

    Args:
        observation_shape: of what is read: cells (frames, 24), int16; planes (4 * frames, 72, 96)
            or a picture (3, height, width), uint8.
        num_features: size of the output.
        device: where the parameters live.
        precision: ``"float32"`` or ``"bfloat16"``.

    Raises:
        ValueError: It is another shape, or the precision is unknown.

    Examples:
        >>> import torch
        >>> network = ImpalaCNN()
        >>> cells = torch.randint(-1, 72 * 96, (5, 2, 4, 24), dtype=torch.int16)
        >>> network(cells).shape
        torch.Size([5, 2, 256])
    """

    def __init__(
        self,
        observation_shape: Sequence[int] = (4, CELLS_PER_FRAME),
        num_features: int = 256,
        device: torch.device | str | None = None,
        precision: Precision = "float32",
    ) -> None:
        super().__init__()
        if precision not in get_args(Precision):
            raise ValueError(
                f"precision is {precision!r}; it must be one of {get_args(Precision)}."
            )
        self.is_mixed = precision == "bfloat16"
        self.plane_shape = _plane_shape(tuple(observation_shape))
        # Of the mini maps that such planes are drawn from; pictures are drawn from none.
        num_frames, without = divmod(self.plane_shape[0], len(SMM_LAYERS))
        self.cell_shape = None if without else (num_frames, CELLS_PER_FRAME)
        self.num_features = num_features = check_count("num_features", num_features)
        num_planes, height, width = self.plane_shape
        channels = [num_planes, 16, 32, 32, 32]
        stages = []
        for num_in, num_out in pairwise(channels):
            stages.append(_Stage(num_in, num_out, device))
            height, width = (height + 1) // 2, (width + 1) // 2
        self.stages = nn.Sequential(*stages)
        self.linear = nn.Linear(channels[-1] * height * width, num_features, device=device)
        self.apply(_initialise)
        # On CPUs this layout takes half the time.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, observation: Tensor) -> Tensor:
        """Maps cells, planes or pictures of any batch shape to ``(*batch, num_features)``.

        Raises:
            ValueError: They are of another shape or dtype.
        """
        mixed = torch.autocast(observation.device.type, torch.bfloat16) if self.is_mixed else None
        with mixed or contextlib.nullcontext():
            planes, batch = self._planes(observation)
            features = F.relu(self.stages(planes), inplace=True).flatten(1)
            features = F.relu(self.linear(features), inplace=True)
        return features.to(self.linear.weight.dtype).view(*batch, self.num_features)

    def _planes(self, observation: Tensor) -> tuple[Tensor, torch.Size]:
        """Planes or pictures in [0, 1], (n, channels, height, width), and their batch shape."""
        shape = observation.shape
        dtype = torch.bfloat16 if self.is_mixed else self.linear.weight.dtype
        if observation.dtype == torch.int16 and shape[-2:] == self.cell_shape:
            cells = observation.reshape(-1, *shape[-2:])
            return cells_to_planes(cells, dtype, channels_last=True), shape[:-2]
        if observation.dtype == torch.uint8 and shape[-3:] == self.plane_shape:
            planes = observation.reshape(-1, *self.plane_shape)
            return planes.to(dtype, memory_format=torch.channels_last).div_(255), shape[:-3]
        raise ValueError(
            f"ImpalaCNN: the observation is {observation.dtype} of shape {tuple(shape)}, but must "
            f"be torch.uint8 of shape (*batch, {', '.join(map(str, self.plane_shape))}), or, for "
            "mini maps, torch.int16 cells from MiniMapCells with as many frames."
        )


class _Stage(nn.Module):
    def __init__(self, num_in: int, num_out: int, device: torch.device | str | None) -> None:
        super().__init__()
        self.conv = nn.Conv2d(num_in, num_out, 3, padding=1, device=device)
        self.residual_1 = _ResidualBlock(num_out, device)
        self.residual_2 = _ResidualBlock(num_out, device)

    def forward(self, x: Tensor) -> Tensor:
        return self.residual_2(self.residual_1(max_pool_same(self.conv(x))))


class _ResidualBlock(nn.Module):
    def __init__(self, num_channels: int, device: torch.device | str | None) -> None:
        super().__init__()
        self.conv_1 = nn.Conv2d(num_channels, num_channels, 3, padding=1, device=device)
        self.conv_2 = nn.Conv2d(num_channels, num_channels, 3, padding=1, device=device)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv_2(F.relu(self.conv_1(F.relu(x)), inplace=True))


def max_pool_same(x: Tensor) -> Tensor:
    """Max-pools 3x3 with stride 2 under TensorFlow's ``SAME`` padding.

    An even size is padded by one behind and none in front, an odd size by one on both sides.
    PyTorch's symmetric padding of one would shift the windows of even sizes. It maps ``(batch,
    channels, height, width)`` to ``(batch, channels, ceil(height / 2), ceil(width / 2))``.
    """
    padding = (x.shape[-2] % 2, x.shape[-1] % 2)
    return F.max_pool2d(x, kernel_size=3, stride=2, padding=padding, ceil_mode=True)


def _plane_shape(shape: tuple[int, ...]) -> tuple[int, int, int]:
    layers = len(SMM_LAYERS)
    if len(shape) == 2 and shape[1] == CELLS_PER_FRAME:
        return check_count("observation_shape[0]", shape[0]) * layers, SMM_HEIGHT, SMM_WIDTH
    if len(shape) == 3:
        planes, height, width = (
            check_count(f"observation_shape[{axis}]", size) for axis, size in enumerate(shape)
        )
        if planes == 3 or (not planes % layers and (height, width) == (SMM_HEIGHT, SMM_WIDTH)):
            return planes, height, width
    raise ValueError(
        f"The observation has shape {shape}; the network impala reads pictures of shape (3, "
        f"height, width), cells of shape (frames, {CELLS_PER_FRAME}) or planes of shape ({layers} "
        f"* frames, {SMM_HEIGHT}, {SMM_WIDTH})."
    )


def _initialise(module: nn.Module) -> None:
    if isinstance(module, (nn.Conv2d, nn.Linear)):
        std = module.weight[0].numel() ** -0.5
        nn.init.trunc_normal_(module.weight, std=std, a=-2 * std, b=2 * std)
        assert module.bias is not None
        nn.init.zeros_(module.bias)
