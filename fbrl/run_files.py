"""What the files of a run are called, relative to its directory."""

from __future__ import annotations

CONFIG_NAME = "config.json"
"""What is trained, and how."""
METRICS_NAME = "metrics.csv"
"""A row for each iteration of the training."""
EVALUATIONS_NAME = "evaluations.csv"
"""A row for each evaluation on fresh matches."""
FRAMES = "frames"
"""The column of both tables that says how many frames had been learned from."""
DENSITY_NAME = "density.npz"
"""The densities of the reward."""
CHECKPOINTS = "checkpoints"
"""The directory of the checkpoints."""
CHECKPOINT_NAME = f"{CHECKPOINTS}/last.pt"
"""The latest checkpoint."""
PREVIOUS_NAME = f"{CHECKPOINTS}/previous.pt"
"""The one before, which is taken where the latest is damaged."""
BEST_NAME = f"{CHECKPOINTS}/best.pt"
"""That of the evaluation with the highest mean goal difference."""
DIVERGED_NAME = "diverged.pt"
"""What led to losses that are not finite."""
REPORT_NAME = "crash.txt"
"""Where each thread was when the process crashed or hung."""
LOCK_NAME = ".lock"
"""Locked by the process that uses the directory."""


def kept_checkpoint_name(frames: int) -> str:
    """The checkpoint of a number of frames that is kept for good."""
    return f"{CHECKPOINTS}/{frames}.pt"
