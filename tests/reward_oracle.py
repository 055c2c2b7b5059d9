"""The assist reward in plain numpy, written from the equations.

Nothing is shared with the transforms: a density is a sum over points, and an episode is walked
step by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

State = dict[str, Any]
Density = Callable[[float, float], float]


class Paid(NamedTuple):
    """What one step earned."""

    scoring: float
    start: float
    end: float

    @property
    def reward(self) -> float:
        return self.scoring + self.start + self.end


def bandwidth(points: np.ndarray) -> float:
    """Equation 4.2; sigma is the root mean square of the axes' standard deviations."""
    n = len(points)
    squares = ((points - points.mean(axis=0)) ** 2).sum() / (n - 1)
    sigma = math.sqrt(squares / 2)
    return (4 * sigma**5 / (3 * n)) ** (1 / 5)


def kernel_density(points: np.ndarray, h: float, x: float, y: float) -> float:
    """Equation 4.1 for two dimensions and one bandwidth."""
    squared_distances = ((points - np.array([x, y])) ** 2).sum(axis=1)
    kernels = np.exp(-squared_distances / (2 * h**2)) / (2 * math.pi * h**2)
    return float(kernels.mean())


def on_pitch(x: float, y: float) -> bool:
    """False for NaN."""
    return abs(x) <= 1 and abs(y) <= 0.42 + 1e-7


def exact_density(points: np.ndarray, peak: float, nodes: np.ndarray) -> Density:
    """The kernel sum over the points, its largest value at the grid's nodes scaled to the peak."""
    h = bandwidth(points)
    highest = max(kernel_density(points, h, x, y) for x, y in nodes)

    def density(x: float, y: float) -> float:
        return peak * kernel_density(points, h, x, y) / highest if on_pitch(x, y) else 0.0

    return density


def has_ball(state: State) -> bool:
    return state["ball_owned_team"] == 0 and state["ball_owned_player"] == state["active"]


def walk(
    first: State,
    steps: Sequence[tuple[State, float]],
    f_start: Density,
    f_end: Density,
    *,
    transition: str = "possession",
    weight: float = 1.0,
) -> list[Paid]:
    """Pay every step of one episode, given its states and its scoring rewards."""
    paid = []
    previous = first
    carrier = None
    for state, scoring in [(first, None), *steps]:
        received = False
        if state["game_mode"] != 0 or state["ball_owned_team"] == 1:
            carrier = None
        elif has_ball(state):
            received = carrier is not None and carrier != state["active"]
            carrier = state["active"]
        if transition == "consecutive":
            received = has_ball(state) and previous["active"] != state["active"]
        if scoring is not None:
            x, y = float(state["ball"][0]), float(state["ball"][1])
            start = weight * f_start(x, y) if has_ball(state) else 0.0
            end = weight * f_end(x, y) if received else 0.0
            paid.append(Paid(scoring, start, end))
        previous = state
    return paid


def carriers(first: State, states: Sequence[State]) -> list[int]:
    """The last controlled player with the ball at every state, -1 for nobody."""
    found = []
    carrier = -1
    for state in [first, *states]:
        if state["game_mode"] != 0 or state["ball_owned_team"] == 1:
            carrier = -1
        elif has_ball(state):
            carrier = state["active"]
        found.append(int(carrier))
    return found
