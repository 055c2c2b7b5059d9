"""Gaussian kernel densities of where goals are made, on the pitch of the environment."""

from fbrl.density.assist import AssistDensity, DensityMetadata
from fbrl.density.controls import open_density
from fbrl.density.coordinates import pitch_from_statsbomb
from fbrl.density.fit import fit_assist_density
from fbrl.density.position import PositionDensity

__all__ = [
    "AssistDensity",
    "DensityMetadata",
    "PositionDensity",
    "fit_assist_density",
    "open_density",
    "pitch_from_statsbomb",
]
