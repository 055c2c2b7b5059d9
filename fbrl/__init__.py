"""fbrl: football agents under TorchRL, with a reward learned from real football."""

__version__ = "0.1.0"
