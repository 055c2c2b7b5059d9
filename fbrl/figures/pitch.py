"""Pictures of passes, densities and an agent's possession on a pitch, with ``mplsoccer``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fbrl.checks import MissingExtraError, missing_packages
from fbrl.density.assist import AssistDensity
from fbrl.density.coordinates import HALF_LENGTH, HALF_WIDTH, PITCH_LENGTH, PITCH_WIDTH
from fbrl.density.passes import Pass
from fbrl.density.position import PositionDensity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CELL_METRES = 2.0


def check_installed() -> None:
    """Raises :class:`fbrl.checks.MissingExtraError` where mplsoccer is not installed."""
    missing = missing_packages(["mplsoccer"])
    if missing:
        raise MissingExtraError("Pictures of a pitch", missing, "density")


def passes_figure(passes: Sequence[Pass], title: str, credit: str = "Data: StatsBomb") -> Figure:
    """Passes as lines from where they start to where they end (Figure 4.1 of the thesis).

    Args:
        passes: at least one.
        title: what they are.
        credit: the credit that the data's owner asks for.
    """
    figure, (axes,) = _pitches(1, colour="#2f6b3a")
    x, y, end_x, end_y = np.array([row.position for row in passes]).T
    size, alpha = (5, 0.25) if len(passes) > 2000 else (11, 0.6)
    lines = np.stack([x, end_x]), np.stack([y, end_y])
    axes.plot(*lines, color="#ffe34d", linewidth=0.6, alpha=alpha, zorder=2)
    dots: Any = {"s": size, "edgecolors": "white", "linewidths": 0.3, "zorder": 3}
    axes.scatter(x, y, color="#d7191c", label="start", **dots)
    axes.scatter(end_x, end_y, color="#1f4fd8", label="end", **dots)
    axes.legend(
        loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=2, frameon=False, fontsize=9,
        markerscale=2, handletextpad=0.1, borderaxespad=0.1,
    )  # fmt: skip
    axes.set_title(title, fontsize=11)
    _sign(axes, credit)
    return figure


def densities_figure(density: AssistDensity) -> Figure:
    """The start and the end density side by side (Figure 4.2 of the thesis)."""
    figure, axes = _pitches(2)
    start, end = density.start, density.end
    _paint(figure, axes[0], start, f"Where assists start, peak {start.peak:g}")
    _paint(figure, axes[1], end, f"Where assists end, peak {end.peak:g}")
    _sign(axes[-1], _credit(density))
    return figure


def agent_figure(
    positions: ArrayLike, density: AssistDensity, title: str, *, is_paid: bool = True
) -> Figure:
    """Where an agent has had the ball, next to the densities.

    Args:
        positions: (n, 2) positions of the ball in pitch units while the agent had it.
        density: the densities.
        title: what is said of the positions.
        is_paid: whether the densities were the agent's reward.
    """
    figure, axes = _pitches(3)
    _paint_share(figure, axes[0], np.asarray(positions, dtype=np.float64), title)
    start, end = "Where assists start", "Where assists end"
    if is_paid:
        start, end = "Paid for having the ball", "Paid for receiving a pass"
    _paint(figure, axes[1], density.start, start)
    _paint(figure, axes[2], density.end, end)
    _sign(axes[-1], _credit(density))
    return figure


def _pitches(count: int, colour: str = "white") -> tuple[Figure, list[Axes]]:
    check_installed()
    from matplotlib.figure import Figure
    from mplsoccer import Pitch

    across = {1: 9.0, 2: 7.0, 3: 5.2}[count]
    size = (across * count, across * PITCH_WIDTH / PITCH_LENGTH + 0.9)
    # Apart from pyplot, which would keep every figure and may want a screen.
    figure = Figure(figsize=size, layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, count)))
    # StatsBomb's own pitch, stretched to the engine's proportions.
    pitch: Any = Pitch(
        pitch_type="statsbomb", pitch_color=colour, line_color="#f2f2f2", linewidth=1.0,
        line_zorder=2.5, pad_left=2, pad_right=2, pad_top=2, pad_bottom=2,
    )  # fmt: skip
    for ax in axes:
        pitch.draw(ax=ax)
        ax.set_aspect((PITCH_WIDTH / 80.0) / (PITCH_LENGTH / 120.0))
        ax.annotate(
            "attack", xy=(70, 83), xytext=(50, 83), va="center", ha="center", fontsize=9,
            color="#555555", annotation_clip=False,
            arrowprops={"arrowstyle": "->", "color": "#555555"},
        )  # fmt: skip
    return figure, axes


def _paint(figure: Figure, axes: Axes, surface: PositionDensity, title: str) -> None:
    values = surface.peak * surface.grid.cpu().numpy()
    _paint_cells(figure, axes, values, title, surface.peak, "reward")


def _paint_share(figure: Figure, axes: Axes, positions: NDArray[np.float64], title: str) -> None:
    cells = [round(PITCH_LENGTH / _CELL_METRES), round(PITCH_WIDTH / _CELL_METRES)]
    counts, _, _ = np.histogram2d(
        positions[:, 0],
        positions[:, 1],
        bins=cells,
        range=[[-HALF_LENGTH, HALF_LENGTH], [-HALF_WIDTH, HALF_WIDTH]],
    )
    share = 100.0 * counts / max(1, len(positions))
    # A few cells, such as the kick-off's, would leave all others dark.
    positive = share[share > 0]
    highest = float(np.quantile(positive, 0.98)) if len(positive) else 1.0
    label = f"% of the time with the ball, in {_CELL_METRES:g} m squares"
    # The square root shows where the ball seldom is, too.
    _paint_cells(figure, axes, share, title, highest, label, power=0.5, interpolation="nearest")


def _paint_cells(
    figure: Figure,
    axes: Axes,
    values: NDArray[np.float64],
    title: str,
    highest: float,
    label: str,
    power: float = 1.0,
    interpolation: str = "bilinear",
) -> None:
    from matplotlib.colors import PowerNorm

    image = axes.imshow(
        values.T,
        extent=(0.0, 120.0, 80.0, 0.0),
        origin="upper",
        aspect=axes.get_aspect(),
        cmap="viridis",
        norm=PowerNorm(power, vmin=0.0, vmax=highest),
        interpolation=interpolation,
        zorder=1,
    )
    axes.set_title(title, fontsize=11)
    over = bool((values > highest * (1 + 1e-9)).any())
    beside = axes.inset_axes((1.02, 0.0, 0.03, 1.0))
    bar = figure.colorbar(image, cax=beside, extend="max" if over else "neither")
    bar.set_label(label, fontsize=9)


def _credit(density: AssistDensity) -> str:
    return density.metadata.credit if density.metadata is not None else ""


def _sign(axes: Axes, credit: str) -> None:
    axes.text(
        1.0, -0.01, credit, transform=axes.transAxes, ha="right", va="top", fontsize=9,
        color="#333333",
    )  # fmt: skip
