"""Rewards, observations, action masks, networks and loggers by name, with their options.

Nothing here imports PyTorch: what a name stands for is imported when it is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from fbrl.registry import BuiltIn, ConfigError, Options, Registry

__all__ = [
    "COMPONENTS",
    "LOGGERS",
    "MASKS",
    "NETWORKS",
    "OBSERVATIONS",
    "PICTURES",
    "REWARDS",
]


@dataclass(frozen=True)
class DensityOptions(Options):
    """Of the rewards that pay for where the ball is."""

    density: str | None = field(default=None, metadata={"values": "FILE|uniform|mirrored|shuffled"})
    """File of the assist densities (see fbrl-density fit), or uniform, mirrored or shuffled, the
    controls; by default those that fbrl ships."""
    weight: float = 1.0
    """Factor of what the densities pay."""


@dataclass(frozen=True)
class AnalyticsOptions(DensityOptions):
    """See :class:`fbrl.transforms.AssistDensityReward`."""

    transition: Literal["possession", "consecutive"] = "possession"
    """What counts as a received pass: possession (the last controlled player with the ball was
    another one) or consecutive (the controlled player changed in this very step)."""
    start_weight: float = 1.0
    """Further factor of the start density; with 0 the end density pays alone."""
    end_weight: float = 1.0
    """That of the end density."""
    episode_cap: float | None = None
    """What the densities can pay in one match at most, in goals; by default there is no limit."""
    release_at_goal: bool = False
    """Withhold what the densities earn until the own team scores; without a goal it is lost."""

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value out of range."""
        cap = self.episode_cap
        if cap is not None and not (math.isfinite(cap) and cap >= 0):
            raise ConfigError(f"episode_cap is {cap}; it must be a number of at least 0.")


@dataclass(frozen=True)
class PotentialOptions(DensityOptions):
    """See :class:`fbrl.transforms.AssistDensityPotential`."""

    start_weight: float = 100.0
    """Factor of the start density within the potential."""


@dataclass(frozen=True)
class ExpertMaskOptions(Options):
    """See :class:`fbrl.transforms.ExpertActionMask`."""

    shot_from_x: float = 0.64
    """Where the zone begins from which shots are allowed; it ends at the goal line."""
    shot_half_width: float = 0.27
    """Half the zone's width."""
    mask_idle: bool = False
    """Mask idle, too."""


@dataclass(frozen=True)
class FramesOptions(Options):
    """Of the mini maps."""

    num_frames: int = 4
    """How many of the latest frames are stacked."""


@dataclass(frozen=True)
class PixelsOptions(Options):
    """See :class:`fbrl.transforms.Pixels`."""

    height: int = 72
    """Of the picture, pixels."""
    width: int = 96
    """Likewise."""


@dataclass(frozen=True)
class MLPOptions(Options):
    """See :class:`fbrl.models.MLP`."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Layer widths of the perceptron."""
    activation: Literal["relu", "tanh"] = "relu"
    """Its activation."""
    layer_norm: bool = False
    """Normalise each of its layers before the activation."""

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value out of range."""
        sizes = self.hidden_sizes
        if not (1 <= len(sizes) <= 64 and min(sizes) >= 1):
            raise ConfigError(
                f"hidden_sizes is {sizes!s:.100}; it must be 1 to 64 positive widths."
            )


@dataclass(frozen=True)
class PlayerSetOptions(MLPOptions):
    """See :class:`fbrl.models.PlayerSet`."""

    embedding_size: int = 32
    """Numbers of a player's embedding."""


@dataclass(frozen=True)
class ImpalaOptions(Options):
    """See :class:`fbrl.models.ImpalaCNN`."""

    precision: Literal["float32", "bfloat16"] = "float32"
    """What it computes in; bfloat16 takes half the memory, and half the time on CPUs with AMX and
    on GPUs."""


REWARDS = Registry(
    "reward",
    analytics=BuiltIn(
        "fbrl.transforms:AssistDensityReward",
        "goals, and having the ball where real assists are made",
        AnalyticsOptions,
    ),
    potential=BuiltIn(
        "fbrl.transforms:AssistDensityPotential",
        "the same densities as a potential, which leaves the best policy that of goals",
        PotentialOptions,
    ),
    checkpoints=BuiltIn(
        "fbrl.transforms:CheckpointReward", "gfootball's ten rewards on the way to the goal"
    ),
    scoring=BuiltIn("fbrl.transforms:ScoringReward", "goals alone"),
)
"""Subclasses of :class:`fbrl.transforms.ScoringReward`; ``gamma`` is the training's discount."""

OBSERVATIONS = Registry(
    "observation",
    simple115=BuiltIn("fbrl.transforms:Simple115", "115 numbers"),
    players=BuiltIn(
        "fbrl.transforms.players:players_with_memory",
        "274 numbers relative to the controlled player",
    ),
    minimap=BuiltIn(
        "fbrl.transforms:MiniMapCells", "stacked mini maps as cell indices", FramesOptions
    ),
    smm=BuiltIn("fbrl.transforms:SuperMiniMap", "the same as dense planes", FramesOptions),
    pixels=BuiltIn(
        "fbrl.transforms:Pixels", "a small picture of the match from above", PixelsOptions
    ),
)
"""TorchRL transforms, such as :class:`fbrl.transforms.RawObservationTransform`'s subclasses; the
network reads the last key that they write."""

PICTURES = ("minimap", "smm", "pixels")
"""Those of them that a convolutional network reads."""

MASKS = Registry(
    "mask",
    engine=BuiltIn("fbrl.transforms:EngineActionMask", "those that the engine ignores in a state"),
    expert=BuiltIn(
        "fbrl.transforms:ExpertActionMask",
        "these, and what experts of this environment rule out, such as shots from afar",
        ExpertMaskOptions,
    ),
)
"""TorchRL transforms that write ``action_mask``, bool (..., 19)."""

NETWORKS = Registry(
    "network",
    mlp=BuiltIn("fbrl.models:MLP", "a perceptron", MLPOptions),
    player_set=BuiltIn(
        "fbrl.models:PlayerSet",
        "team-mates and opponents of the observation players as sets",
        PlayerSetOptions,
    ),
    impala=BuiltIn("fbrl.models:ImpalaCNN", "the convolutions of gfootball's paper", ImpalaOptions),
)
"""Modules from an observation (..., *shape) to features (..., n); the first argument is shape."""

COMPONENTS = {"reward": REWARDS, "observation": OBSERVATIONS, "mask": MASKS, "network": NETWORKS}
"""What a training is made of, by kind."""

LOGGERS = Registry(
    "logger",
    wandb=BuiltIn("fbrl.monitor.services:open_wandb", "Weights & Biases"),
    mlflow=BuiltIn("fbrl.monitor.services:open_mlflow", "MLflow"),
)
"""Take a run's directory and the service's name of the run, and return a
:class:`fbrl.monitor.services.Service`."""
