"""A training from its configuration to its last checkpoint, and whatever may come in between."""

from fbrl.training.trainer import TrainListener, TrainResult, train

__all__ = ["TrainListener", "TrainResult", "train"]
