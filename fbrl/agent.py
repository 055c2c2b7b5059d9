"""An agent from a configuration, and from the checkpoint of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.checkpoint import CheckpointError, load_checkpoint
from fbrl.config import ConfigError, TrainConfig, config_from_dict
from fbrl.envs.factory import make_reward
from fbrl.models.actor_critic import ActorCritic, build_actor_critic
from fbrl.transforms import ScoringReward


@dataclass(frozen=True)
class Agent:
    """A trained network and what it was trained with.

    Attributes:
        config: The training's configuration.
        frames: Frames that it was trained on.
        model: The network, on the device that was asked for.
    """

    config: TrainConfig
    frames: int
    model: ActorCritic


def make_model(config: TrainConfig, device: torch.device) -> ActorCritic:
    """The network that a configuration asks for, with fresh weights."""
    return build_actor_critic(
        config.observation,  # type: ignore[arg-type]  # checked against its names
        hidden_sizes=config.hidden_sizes,
        activation=config.activation,  # type: ignore[arg-type]
        device=device,
    )


def make_training_reward(config: TrainConfig) -> ScoringReward:
    """The reward that a configuration asks for.

    Raises:
        ConfigError: Its density can't be read.
    """
    if config.reward != "analytics":
        return make_reward(config.reward)
    try:
        return make_reward(config.reward, density=config.density, transition=config.transition)
    except (ValueError, OSError) as error:
        raise ConfigError(str(error)) from error


def load_agent(path: Path, device: torch.device | str = "cpu") -> Agent:
    """Loads the agent of a checkpoint.

    Args:
        path: A checkpoint, or the directory of a run, whose latest one is taken.
        device: Where the network goes.

    Raises:
        CheckpointError: There is none, it is damaged, or it is no training's.
    """
    content = load_checkpoint(path, device)
    try:
        config = config_from_dict(content["config"])
        config.check()
        model = make_model(config, torch.device(device))
        model.load_state_dict(content["model"])
        return Agent(config, int(content["frames"]), model)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if isinstance(error, ConfigError) else repr(error)
        raise CheckpointError(
            f"The checkpoint at {path} is not that of a training ({reason[:200]})."
        ) from error
