"""Proximal policy optimisation on TorchRL's environments, advantage estimator and loss."""
