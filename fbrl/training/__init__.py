"""A training from its configuration to its last checkpoint, and whatever may come in between."""

from fbrl.training.listener import TrainListener, TrainResult
from fbrl.training.trainer import train

__all__ = ["TrainListener", "TrainResult", "train"]
