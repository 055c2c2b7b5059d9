"""How figures look: readable in print, told apart by the colour-blind."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from fbrl.checks import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette for all kinds of colour vision, without its yellow, pale on paper."""

LINE_STYLES = ("-", "--", ":", "-.")
"""Taken one after the other when the colours are used up."""

_FONT_SIZE = 11
_LETTERS_PER_INCH = 13
_LETTERS_BESIDE = 8
_LINE_HEIGHT = 0.22


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    """An empty figure, in inches, with one pair of axes.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("Figures", ["matplotlib"], "analysis") from error

    # Apart from pyplot, which would keep every figure and may want a screen.
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=_FONT_SIZE)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
    return figure, axes


def set_labels(axes: Axes, title: str, x: str, y: str) -> None:
    """Writes the title and what the axes show."""
    axes.set_title(title, fontsize=_FONT_SIZE + 1)
    axes.set_xlabel(x, fontsize=_FONT_SIZE)
    axes.set_ylabel(y, fontsize=_FONT_SIZE)


def add_legend(axes: Axes, note: str | None = None) -> None:
    """Explains the colours below the axes, where nothing is hidden, under a note on all of them."""
    handles, labels = axes.get_legend_handles_labels()
    figure = axes.get_figure(root=True)
    assert figure is not None
    letters = int(figure.get_figwidth() * _LETTERS_PER_INCH)
    columns = max(1, min(len(labels), letters // (max(map(len, labels)) + _LETTERS_BESIDE)))
    texts = [textwrap.fill(label, letters - _LETTERS_BESIDE) for label in labels]
    lines = sum(text.count("\n") + 1 for text in texts) / columns
    figure.set_figheight(figure.get_figheight() + _LINE_HEIGHT * lines)
    figure.legend(
        handles, texts, loc="outside lower center", ncols=columns, frameon=False,
        fontsize=_FONT_SIZE - 1, title=note, title_fontsize=_FONT_SIZE - 1,
    )  # fmt: skip


def count_frames(axis: Axis, most: float) -> str:
    """Labels an axis of at most so many frames in thousands or millions; returns its name."""
    unit, word = (1e6, "millions") if most >= 1e6 else (1e3, "thousands")
    axis.set_major_formatter(lambda frames, _: f"{frames / unit:g}")
    return f"environment frames ({word})"
