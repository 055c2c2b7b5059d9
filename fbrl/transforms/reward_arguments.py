"""Arguments that the density rewards share, checked."""

from __future__ import annotations

import os
import sys

from fbrl.density import AssistDensity, open_density


def check_number(name: str, value: float, highest: float = sys.float_info.max) -> float:
    """A number from 0 to ``highest``, as a float.

    Raises:
        TypeError: it is no number.
        ValueError: it is out of range, or not finite.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name} is {value!r}; expected a number.")
    if not 0 <= value <= highest:
        unbounded = highest == sys.float_info.max
        allowed = "of at least 0" if unbounded else f"from 0 to {highest:g}"
        raise ValueError(f"{name} is {value!r}; expected a finite number {allowed}.")
    return float(value)


def density_from(density: AssistDensity | str | os.PathLike[str] | None) -> AssistDensity:
    """The densities that a reward is given, in any of the ways that it takes them.

    Raises:
        TypeError: it is none of them.
        ValueError, OSError: they can't be read, see :func:`fbrl.density.open_density`.
    """
    if density is None:
        return AssistDensity.default()
    if isinstance(density, (str, os.PathLike)):
        return open_density(density)
    if not isinstance(density, AssistDensity):
        raise TypeError(
            f"density is a {type(density).__name__}; expected an AssistDensity, a name or the path "
            "of a density file, or None for the shipped one."
        )
    return density
