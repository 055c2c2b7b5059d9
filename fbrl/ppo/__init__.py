"""Proximal policy optimisation on TorchRL's collector, advantage estimator and loss."""
