"""TorchRL transforms for rewards and observations; usable without gfootball installed."""

from fbrl.transforms.action_masks import EngineActionMask, ExpertActionMask
from fbrl.transforms.action_memory import ActionMemory
from fbrl.transforms.assist_potential import AssistDensityPotential
from fbrl.transforms.assist_reward import AssistDensityReward
from fbrl.transforms.ball_control import Observation, in_control
from fbrl.transforms.checkpoint_reward import CheckpointReward
from fbrl.transforms.memory import Memory
from fbrl.transforms.minimap import MiniMapCells, SuperMiniMap
from fbrl.transforms.pixels import Pixels
from fbrl.transforms.play_statistics import PLAY_STATISTICS, PlayStatistics
from fbrl.transforms.players import PLAYERS_FEATURES, Players
from fbrl.transforms.raw_observation import RawObservationTransform
from fbrl.transforms.scoring_reward import ScoringReward
from fbrl.transforms.shaped_reward import ShapedReward
from fbrl.transforms.simple115 import Simple115

__all__ = [
    "PLAYERS_FEATURES",
    "PLAY_STATISTICS",
    "ActionMemory",
    "AssistDensityPotential",
    "AssistDensityReward",
    "CheckpointReward",
    "EngineActionMask",
    "ExpertActionMask",
    "Memory",
    "MiniMapCells",
    "Observation",
    "Pixels",
    "PlayStatistics",
    "Players",
    "RawObservationTransform",
    "ScoringReward",
    "ShapedReward",
    "Simple115",
    "SuperMiniMap",
    "in_control",
]
