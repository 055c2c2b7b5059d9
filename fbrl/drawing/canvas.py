"""Anti-aliased shapes and text on an array of pixels.

OpenCV draws the shapes: some microseconds each, at fractions of pixels, and straight into the
array, where a plotting library takes a tenth of a second for each frame. Its letters are poor, so
text is set by Pillow, once for each string, in the font that matplotlib brings along.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

Colour = tuple[int, int, int]
Point = Sequence[float] | np.ndarray

# OpenCV takes fractions of a pixel as integers with this many bits after the point.
_FRACTION_BITS = 4


def _fixed(*values: float) -> list[int]:
    return [round(float(value) * (1 << _FRACTION_BITS)) for value in values]


def circle(
    frame: np.ndarray, centre: Point, radius: float, colour: Colour, thickness: int = -1
) -> None:
    """Draws a circle, filled unless it has a thickness in pixels."""
    x, y, radius = _fixed(*centre, radius)
    cv2.circle(frame, (x, y), radius, colour, thickness, cv2.LINE_AA, _FRACTION_BITS)


def line(frame: np.ndarray, start: Point, end: Point, colour: Colour, thickness: int) -> None:
    """Draws a straight line."""
    cv2.line(
        frame, _fixed(*start), _fixed(*end), colour, thickness, cv2.LINE_AA, shift=_FRACTION_BITS
    )


def arrow(frame: np.ndarray, start: Point, end: Point, colour: Colour, thickness: int) -> None:
    """Draws a line with a filled head at its end, a few line widths long."""
    tip = np.asarray(end, float)
    along = tip - np.asarray(start, float)
    length = float(np.hypot(*along))
    if length < 1.0:
        return
    along /= length
    across = np.array([-along[1], along[0]])
    head = min(length, 2.5 + 3.0 * thickness)
    base = tip - head * along
    line(frame, start, base, colour, thickness)
    corners = np.array([tip, base + 0.5 * head * across, base - 0.5 * head * across])
    fixed = np.round(corners * (1 << _FRACTION_BITS)).astype(np.int32)
    cv2.fillConvexPoly(frame, fixed, colour, cv2.LINE_AA, _FRACTION_BITS)


def rectangle(frame: np.ndarray, corner: Point, size: Point, colour: Colour) -> None:
    """Fills a rectangle on whole pixels."""
    left, top = round(corner[0]), round(corner[1])
    frame[top : top + round(size[1]), left : left + round(size[0])] = colour


def text(
    frame: np.ndarray,
    position: Point,
    string: str,
    size: float,
    colour: Colour,
    *,
    anchor: str = "lm",
    bold: bool = False,
) -> None:
    """Writes a line of text, cut off at the frame's edges.

    Args:
        frame: Written into.
        position: Where the anchor goes, pixels.
        string: The text.
        size: Of the font, pixels.
        colour: Of the letters.
        anchor: ``"lm"``, ``"mm"`` or ``"rm"``: left, middle or right end of the line's middle.
        bold: Thicker letters.
    """
    mask = _text_mask(string, max(round(size), 6), bold)
    height, width = mask.shape
    left = round(position[0] - {"l": 0.0, "m": 0.5, "r": 1.0}[anchor[0]] * width)
    top = round(position[1] - height / 2)
    blend(frame, mask, (left, top), colour)


def text_width(string: str, size: float, bold: bool = False) -> int:
    """How many pixels :func:`text` takes for it."""
    return _text_mask(string, max(round(size), 6), bold).shape[1]


def blend(frame: np.ndarray, mask: np.ndarray, corner: tuple[int, int], colour: Colour) -> None:
    """Mixes a colour in where a uint8 mask says so, cut off at the frame's edges."""
    left, top = corner
    skip_x, skip_y = max(0, -left), max(0, -top)
    target = frame[top + skip_y : top + mask.shape[0], left + skip_x : left + mask.shape[1]]
    weight = mask[skip_y:, skip_x:][: target.shape[0], : target.shape[1], None] / 255.0
    target[:] = np.rint(target + (np.array(colour) - target) * weight).astype(np.uint8)


@functools.lru_cache(maxsize=512)
def _text_mask(string: str, size: int, bold: bool) -> np.ndarray:
    font = _font(size, bold)
    ascent, descent = font.getmetrics()
    width = max(1, round(font.getlength(string)))
    image = Image.new("L", (width + 1, ascent + descent))
    ImageDraw.Draw(image).text((0, 0), string, fill=255, font=font)
    mask = np.asarray(image).copy()
    mask.flags.writeable = False
    return mask


@functools.lru_cache(maxsize=64)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    fonts = Path(matplotlib.get_data_path(), "fonts", "ttf")
    return ImageFont.truetype(fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf", size)
