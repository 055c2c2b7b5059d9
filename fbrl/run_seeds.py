"""The seeds that follow from that of a training: for fresh matches, and after a crash."""

from __future__ import annotations

import numpy as np

from fbrl.config import TrainConfig


def other_seed(seed: int) -> int:
    """A seed whose matches are not those of the given one, far from those that people choose."""
    return (seed + 2**31) % 2**32


def fresh_seed(config: TrainConfig | None, scenario: str, seed: int) -> int:
    """The seed of an evaluation in a scenario: another one if the training began with this one.

    ``config`` is the training; None for a policy that was not trained.
    """
    is_trainings = config is not None and (scenario, seed) == (config.scenario, config.seed)
    return other_seed(seed) if is_trainings else seed


def seed_after_crashes(seed: int, crashes: int) -> int:
    """The seed with which a training goes on after some crashes: another one after each."""
    if not crashes:
        return seed
    return int(np.random.SeedSequence([seed, crashes]).generate_state(1)[0])
