"""Where networks run: the device of a name."""

from __future__ import annotations

import torch

from fbrl.config import ConfigError


def choose_device(name: str) -> torch.device:
    """The device of a name; ``"auto"`` is CUDA where there is one, else the CPU.

    Raises:
        ConfigError: There is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"device is {name!r}; it must be auto, cpu, cuda or cuda:1.") from error
    count = torch.cuda.device_count()
    if device.type == "cuda" and not count:
        raise ConfigError(
            f"device is {name!r}, but PyTorch finds no CUDA device. Use cpu, or install a CUDA "
            "build of PyTorch and its driver."
        )
    if device.type == "cuda" and (device.index or 0) >= count:
        raise ConfigError(f"device is {name!r}; the last CUDA device here is cuda:{count - 1}.")
    if device.type not in ("cpu", "cuda"):
        raise ConfigError(f"device is {name!r}; it must be auto, cpu, cuda or cuda:1.")
    return device
