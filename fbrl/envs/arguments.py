"""Checks of what is given to ``step`` and ``reset``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def check_options(options: Any, known: tuple[str, ...]) -> Mapping[str, Any]:
    """Returns the options of a reset, none of them for ``None``.

    Raises:
        ValueError: They are no dictionary, or there is one that is not known.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping) or not set(options) <= set(known):
        allowed = " and ".join(known) or "none"
        raise ValueError(f"The options of reset() are {options!r}; allowed: {allowed}.")
    return options


def check_mask(mask: Any, num_envs: int) -> np.ndarray:
    """Returns the mask of a reset, true everywhere for ``None``; shape (num_envs,).

    Raises:
        ValueError: It has another shape or is not boolean.
    """
    if mask is None:
        return np.ones(num_envs, bool)
    mask = _as_array("reset_mask", mask)
    if mask.shape != (num_envs,) or mask.dtype != bool:
        raise ValueError(
            f"reset_mask has shape {mask.shape} and dtype {mask.dtype}; it must be boolean of "
            f"shape ({num_envs},)."
        )
    return mask


def check_actions(actions: Any, num_envs: int, num_actions: int) -> np.ndarray:
    """Returns the actions of a step as an array of shape (num_envs,).

    Raises:
        ValueError: They have another shape or dtype, or are not all in [0, num_actions - 1].
    """
    actions = _as_array("Actions", actions)
    if actions.shape != (num_envs,) or not np.issubdtype(actions.dtype, np.integer):
        raise ValueError(
            f"Actions have shape {actions.shape} and dtype {actions.dtype}; they must be integers "
            f"of shape ({num_envs},)."
        )
    if actions.min() < 0 or actions.max() >= num_actions:
        raise ValueError(f"Actions {actions.tolist()} are not all in [0, {num_actions - 1}].")
    return actions


def _as_array(name: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"{name} are {values!r}, which make no array.") from error
