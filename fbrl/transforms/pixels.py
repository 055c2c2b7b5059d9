"""The match from above as a small picture, for networks that look at pixels."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from fbrl.checks import check_count
from fbrl.density.coordinates import METRES_PER_UNIT, PITCH_LENGTH, PITCH_WIDTH
from fbrl.transforms.raw_observation import Keys, RawObservationTransform

MARGIN = 4.0
"""Grass around the pitch, where players may run, metres."""

TRAIL_STEPS = 10
"""How long a trail is, in steps of 100 ms at the speed of now."""

SMALLEST_SIDE, LARGEST_SIDE = 24, 1024
"""Of the pictures, pixels."""

_PLAYER_RADIUS, _BALL_RADIUS, _BALL_GROWTH = 1.15, 0.62, 0.07
_HIGHEST = 10.0

# Later ones are drawn over earlier ones.
_GRASS, _LINE, _LEFT_TRAIL, _RIGHT_TRAIL, _BALL_TRAIL, _RIGHT, _LEFT, _CONTROLLED, _BALL = range(9)
_PALETTE = (
    (40, 96, 56),
    (128, 160, 136),
    (32, 64, 128),
    (112, 48, 48),
    (176, 176, 176),
    (224, 48, 48),
    (48, 112, 240),
    (255, 232, 56),
    (255, 255, 255),
)


class Pixels(RawObservationTransform):
    """The match from above in colour, as a picture for a convolutional network.

    Writes ``pixels``, a uint8 tensor of shape ``(*batch, 3, height, width)``: red, green and blue
    of the pitch with four metres around it, the attack towards the right. Our players are blue,
    the controlled one with a yellow rim, the opponents red; the ball is white and the larger the
    higher it flies. What moves draws a darker trail: where it was in the last second at the speed
    that it has now. So one picture shows what of a video takes several; neither score nor time is
    seen.

    It is drawn on the device of the observations.

    Args:
        height: of the picture, 24 to 1024 pixels.
        width: likewise.
        in_keys: where to find the raw observations, in the order of :attr:`fields`.
        out_keys: where to write the picture.

    Raises:
        ValueError: if a side is out of range, or there are more or fewer keys than these.
        TypeError: if a side is no integer.

    Examples:
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_corner", num_envs=2, observation=Pixels(), seed=0)
        >>> picture = env.reset()["pixels"]
        >>> picture.shape, picture.dtype
        (torch.Size([2, 3, 72, 96]), torch.uint8)
        >>> (picture[0] == 255).all(0).sum().item()  # the ball
        5
    """

    fields = (
        "left_team",
        "left_team_direction",
        "left_team_active",
        "right_team",
        "right_team_direction",
        "right_team_active",
        "ball",
        "ball_direction",
        "active",
    )
    out_key = "pixels"

    def __init__(
        self, height: int = 72, width: int = 96, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        super().__init__(in_keys, out_keys)
        for name, side in (("height", height), ("width", width)):
            if not SMALLEST_SIDE <= check_count(name, side) <= LARGEST_SIDE:
                raise ValueError(
                    f"{name} is {side}; it must be in [{SMALLEST_SIDE}, {LARGEST_SIDE}]."
                )
        self.height, self.width = height, width

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns the pictures (*batch, 3, height, width)."""
        left, left_movement, left_active, right, right_movement, right_active, *others = fields
        ball, ball_movement, active = others
        batch, device = active.shape, active.device
        picture = _Picture(batch.numel(), self.height, self.width, device)
        left, left_movement, right, right_movement = (
            field.reshape(-1, 11, 2) for field in (left, left_movement, right, right_movement)
        )
        left_plays, right_plays = (
            field.reshape(-1, 11) == 1 for field in (left_active, right_active)
        )
        ball, ball_movement = ball.reshape(-1, 1, 3), ball_movement.reshape(-1, 1, 3)
        ball_plays = torch.ones_like(ball[..., 0], dtype=torch.bool)
        is_controlled = torch.arange(11, device=device) == active.reshape(-1, 1)

        trail = max(0.5, _BALL_RADIUS * picture.pixels_per_metre)
        steps = torch.arange(1, TRAIL_STEPS + 1, device=device)[:, None, None]
        for points, movement, plays, colour in (
            (left, left_movement, left_plays, _LEFT_TRAIL),
            (right, right_movement, right_plays, _RIGHT_TRAIL),
            (ball[..., :2], ball_movement[..., :2], ball_plays, _BALL_TRAIL),
        ):
            before = points.unsqueeze(1) - steps * movement.unsqueeze(1)
            picture.draw_discs(before.flatten(1, 2), plays.repeat(1, TRAIL_STEPS), colour, trail)
        player = max(1.5, _PLAYER_RADIUS * picture.pixels_per_metre)
        picture.draw_discs(left, left_plays & is_controlled, _CONTROLLED, player + 1.0)
        picture.draw_discs(right, right_plays, _RIGHT, player)
        picture.draw_discs(left, left_plays, _LEFT, player)
        ball_height = ball[..., 2].clamp(0.0, _HIGHEST)
        radius = (_BALL_RADIUS + _BALL_GROWTH * ball_height) * picture.pixels_per_metre
        largest = max(1.0, (_BALL_RADIUS + _BALL_GROWTH * _HIGHEST) * picture.pixels_per_metre)
        picture.draw_discs(ball[..., :2], ball_plays, _BALL, largest, radius.clamp(min=1.0))
        return picture.colours().view(*batch, 3, self.height, self.width)


class _Picture:
    """Pictures of several matches, painted over an empty pitch, colour by colour."""

    def __init__(self, number: int, height: int, width: int, device: torch.device) -> None:
        self._height, self._width = height, width
        size = height * width
        # One more than there are pixels: what is not seen is painted there, so that the number of
        # indices does not depend on the data, which would make a GPU wait.
        self._paint = torch.empty(number * size + 1, dtype=torch.uint8, device=device)
        self._paint[:-1].view(number, size).copy_(_empty_pitch(height, width, device).flatten())
        self._first = torch.arange(number, device=device)[:, None, None] * size
        self._scale, self._middle, self.pixels_per_metre = _grid(height, width, device)

    def draw_discs(
        self,
        points: Tensor,
        is_there: Tensor,
        colour: int,
        largest: float,
        radius: Tensor | None = None,
    ) -> None:
        """Paints discs of a number of the palette around points (matches, n, 2) in pitch units.

        Those are drawn that are there, bool (matches, n). ``largest`` is their radius in pixels;
        ``radius`` that of each, (matches, n), at most the largest, where they differ.
        """
        offsets = _offsets(int(largest + 0.5), points.device)
        squared = largest**2 if radius is None else radius.square().unsqueeze(-1)
        is_seen = is_there.unsqueeze(-1) & (offsets.square().sum(-1) <= squared + 0.25)
        # Column and row; the middle of a pixel is a whole number. In 64 bits, in which a mirrored
        # match is a mirrored picture: next to the middle line, 32 round points of both sides onto
        # the same one.
        middles = (points.double() * self._scale + self._middle).round_()
        pixels = (middles.unsqueeze(-2) + offsets).nan_to_num(nan=-1.0)
        column, row = pixels.clamp(-1, LARGEST_SIDE).long().unbind(-1)
        is_seen = is_seen & (column >= 0) & (column < self._width)
        is_seen = is_seen & (row >= 0) & (row < self._height)
        index = self._first + (row * self._width + column)
        index = torch.where(is_seen, index, len(self._paint) - 1)
        self._paint.index_fill_(0, index.flatten(), colour)

    def colours(self) -> Tensor:
        """Red, green and blue, uint8 (matches, 3, pixels)."""
        paint = self._paint[:-1].view(len(self._first), self._height * self._width).int()
        return torch.stack([channel[paint] for channel in _palette(self._paint.device)], 1)


# Made once for each device: to copy numbers there makes a GPU wait.
@lru_cache
def _palette(device: torch.device) -> tuple[Tensor, ...]:
    """Red, green and blue of each number that is painted, uint8 (numbers,) each."""
    return torch.tensor(_PALETTE, dtype=torch.uint8, device=device).unbind(-1)


@lru_cache
def _grid(height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor, float]:
    """Pixels in a pitch unit and the middle's pixel, float64 (2,) each; pixels in a metre."""
    per_metre = width / (PITCH_LENGTH + 2 * MARGIN), height / (PITCH_WIDTH + 2 * MARGIN)
    per_unit = [pixels * unit for pixels, unit in zip(per_metre, METRES_PER_UNIT, strict=True)]
    middle = [(width - 1) / 2, (height - 1) / 2]
    scale_and_middle = torch.tensor([per_unit, middle], dtype=torch.float64, device=device)
    return scale_and_middle[0], scale_and_middle[1], min(per_metre)


@lru_cache
def _offsets(reach: int, device: torch.device) -> Tensor:
    """Columns and rows of pixels from the one in their middle, (pixels, 2)."""
    line = torch.arange(-reach, reach + 1, device=device)
    return torch.cartesian_prod(line, line)


@lru_cache
def _empty_pitch(height: int, width: int, device: torch.device) -> Tensor:
    """Grass and lines, uint8 (height, width) of palette numbers."""
    x_step, y_step = (PITCH_LENGTH + 2 * MARGIN) / width, (PITCH_WIDTH + 2 * MARGIN) / height
    columns, rows = (
        torch.arange(size, dtype=torch.float64, device=device) for size in (width, height)
    )
    x = ((columns - (width - 1) / 2) * x_step).abs()[None, :]
    y = ((rows - (height - 1) / 2) * y_step).abs()[:, None]

    def rectangle(inner: float, outer: float, half_width: float) -> Tensor:
        """The border of what lies between two distances from the middle line, on both sides."""
        at_ends = ((x - inner).abs() <= x_step / 2) | ((x - outer).abs() <= x_step / 2)
        along = ((y - half_width).abs() <= y_step / 2) & (x >= inner) & (x <= outer)
        return (at_ends & (y <= half_width)) | along

    half_length, half_width = PITCH_LENGTH / 2, PITCH_WIDTH / 2
    thickness = max(x_step, y_step)
    circle = ((x.square() + y.square()).sqrt() - 9.15).abs() <= thickness / 2
    is_line = rectangle(0.0, half_length, half_width) | circle
    for depth, box_half_width in ((16.5, 20.15), (5.5, 9.16)):
        is_line = is_line | rectangle(half_length - depth, half_length, box_half_width)
    return torch.where(is_line, _LINE, _GRASS).to(torch.uint8)
