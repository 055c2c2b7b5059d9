"""Densities that hold no football: controls for asking whether the data helps, or possession."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from fbrl.density.assist import AssistDensity
from fbrl.density.position import PositionDensity

SHUFFLE_SEED = 0


def uniform(density: AssistDensity, positions: Tensor | None = None) -> AssistDensity:
    """The same everywhere: possession is paid, and where it is tells nothing.

    Either surface is a constant, by default the fitted surface's mean over the pitch. An agent
    whose ball is mostly in front of the goal earns less from it than from the fitted densities; to
    pay it as much, give the positions of its ball.

    Args:
        density: the densities to compare with.
        positions: (n, 2) positions in pitch units, such as those of
            :func:`fbrl.evaluation.possession.ball_positions`, to take the mean over instead.

    Raises:
        ValueError: if none of the positions is where the densities are above 0.
        TypeError: if these are no densities.
    """

    def constant(surface: PositionDensity) -> PositionDensity:
        mean = mean_over_pitch(surface) if positions is None else float(surface(positions).mean())
        if not mean > 0:
            raise ValueError(
                "The densities' mean over the positions is not above 0: is none there?"
            )
        return PositionDensity(torch.ones(2, 2), mean)

    name = "uniform" if positions is None else f"uniform (mean at {len(positions)} positions)"
    return _control(density, name, constant)


def mirrored(density: AssistDensity) -> AssistDensity:
    """The densities turned round, x to -x: what they pay for is at the wrong end of the pitch."""
    return _control(
        density, "mirrored", lambda surface: PositionDensity(surface.grid.flip(0), surface.peak)
    )


def shuffled(density: AssistDensity, seed: int = SHUFFLE_SEED) -> AssistDensity:
    """The densities' grid nodes in a random order: the same values, at places that mean nothing.

    The mean over the pitch stays within a few percent: interpolation gives the nodes on the lines
    less area than the others. The seed decides the order.
    """
    generator = torch.Generator().manual_seed(seed)

    def permuted(surface: PositionDensity) -> PositionDensity:
        grid = surface.grid.cpu()
        order = torch.randperm(grid.numel(), generator=generator)
        return PositionDensity(grid.flatten()[order].reshape(grid.shape), surface.peak)

    return _control(density, f"shuffled (seed {seed})", permuted)


BUILT_IN: dict[str, Callable[[], AssistDensity]] = {
    "default": AssistDensity.default,
    "uniform": lambda: uniform(AssistDensity.default()),
    "mirrored": lambda: mirrored(AssistDensity.default()),
    "shuffled": lambda: shuffled(AssistDensity.default()),
}
"""Densities that have a name: those that fbrl ships, and the controls made of them."""


def open_density(name_or_path: str | os.PathLike[str]) -> AssistDensity:
    """Densities by name or from a file.

    Args:
        name_or_path: ``"default"``, ``"uniform"``, ``"mirrored"``, ``"shuffled"``, or the path of
            a density file. A file of such a name is ``./uniform``.

    Raises:
        OSError: if there is neither such a name nor such a file, or it cannot be read.
        TypeError: if it is neither a name nor a path.
        ValueError: if the file is no density file.

    Examples:
        >>> import torch
        >>> from fbrl.density import open_density
        >>> density = open_density("uniform")
        >>> density.end(torch.tensor([[0.9, 0.0], [-0.9, 0.3]])).round(decimals=4)
        tensor([0.0035, 0.0035])
    """
    if not isinstance(name_or_path, (str, os.PathLike)):
        raise TypeError(
            f"The density is {name_or_path!r}; expected a path, or one of {', '.join(BUILT_IN)}."
        )
    if name_or_path in BUILT_IN:
        return BUILT_IN[str(name_or_path)]()
    if not Path(name_or_path).is_file():
        raise FileNotFoundError(
            f"No density file at {name_or_path}. Fit one with `fbrl-density fit`, or name one of "
            f"{', '.join(BUILT_IN)}."
        )
    return AssistDensity.load(name_or_path)


def mean_over_pitch(surface: PositionDensity) -> float:
    """The density's mean over the pitch's area, exactly that of the interpolated surface."""
    columns, rows = surface.grid.shape
    total = torch.trapezoid(torch.trapezoid(surface.grid.cpu().double(), dim=1), dim=0)
    return surface.peak * float(total) / ((columns - 1) * (rows - 1))


def _control(
    density: AssistDensity, name: str, change: Callable[[PositionDensity], PositionDensity]
) -> AssistDensity:
    if not isinstance(density, AssistDensity):
        raise TypeError(f"density is a {type(density).__name__}; expected an AssistDensity.")
    metadata = density.metadata
    if metadata is not None:
        metadata = dataclasses.replace(metadata, source=f"{name} control of: {metadata.source}")
    return AssistDensity(change(density.start), change(density.end), metadata)
