"""Proximal policy optimisation on TorchRL's environments, advantage estimator and loss."""

from fbrl.ppo.algorithm import PPO

__all__ = ["PPO"]
