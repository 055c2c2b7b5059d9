"""TorchRL transforms for rewards and observations; usable without gfootball installed."""

from fbrl.transforms.minimap import MiniMapCells, SuperMiniMap
from fbrl.transforms.simple115 import Simple115

__all__ = ["MiniMapCells", "Simple115", "SuperMiniMap"]
