"""Gaussian kernel densities of where goals are made, on the pitch of the environment."""
