"""An agent from a configuration, and from the checkpoint of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import Transform

from fbrl.checkpoint import CheckpointError, load_checkpoint
from fbrl.checks.counts import check_count
from fbrl.config import ConfigError, TrainConfig
from fbrl.config_json import config_from_dict
from fbrl.envs.factory import make_masked_observation, make_reward
from fbrl.models.actor_critic import ActorCritic, build_actor_critic
from fbrl.run_files import CHECKPOINTS, DENSITY_NAME
from fbrl.transforms import ScoringReward


@dataclass(frozen=True)
class Agent:
    """A trained network and what it was trained with.

    Attributes:
        config: The training's configuration.
        frames: Frames that it was trained on.
        model: The network, on the device that was asked for.
        run_dir: The directory of its run; None for a checkpoint that lies elsewhere.
    """

    config: TrainConfig
    frames: int
    model: ActorCritic
    run_dir: Path | None = None


def make_model(config: TrainConfig, device: torch.device) -> ActorCritic:
    """The network that a configuration asks for, with fresh weights."""
    return build_actor_critic(
        config.observation,  # type: ignore[arg-type]  # checked against its names
        hidden_sizes=config.hidden_sizes,
        activation=config.activation,  # type: ignore[arg-type]
        network=config.network,  # type: ignore[arg-type]
        is_mirrored=config.mirror,
        is_masked=config.mask is not None,
        device=device,
    )


def make_agent_observation(config: TrainConfig) -> Transform:
    """What the agent of a configuration looks at, its action mask included."""
    return make_masked_observation(config.observation, config.mask)


def make_training_reward(config: TrainConfig, run_dir: Path | None = None) -> ScoringReward:
    """The reward that a configuration asks for.

    Args:
        config: The training.
        run_dir: The directory of its run. The densities that it keeps, if there are any, are taken
            instead of those that the configuration names, which may have changed since.

    Raises:
        ConfigError: Its density can't be read.
    """
    density: str | Path | None = config.density
    if run_dir is not None and (run_dir / DENSITY_NAME).is_file():
        density = run_dir / DENSITY_NAME
    options: dict[str, Any] = {}
    if config.reward == "analytics":
        options = {
            "density": density,
            "transition": config.transition,
            "episode_cap": config.episode_cap,
        }
    elif config.reward == "potential":
        options = {"density": density, "gamma": config.ppo.gamma}
    try:
        return make_reward(config.reward, **options)
    except (ValueError, OSError) as error:
        raise ConfigError(str(error)) from error


def keep_density(reward: ScoringReward, run_dir: Path) -> None:
    """Keeps the densities of a reward, if it has any, with its run.

    Raises:
        OSError: They can't be written.
    """
    if reward.density is not None:
        reward.density.save(run_dir / DENSITY_NAME)


def load_agent(path: Path, device: torch.device | str = "cpu") -> Agent:
    """Loads the agent of a checkpoint.

    Args:
        path: A checkpoint, or the directory of a run, whose latest one is taken.
        device: Where the network goes.

    Raises:
        CheckpointError: There is none, it is damaged, or it is no training's.
    """
    device = torch.device(device)
    content = load_checkpoint(path)
    try:
        config = config_from_dict(content["config"])
        config.check()
        _check_shapes(config, content["model"])
        model = make_model(config, device)
        model.load_state_dict(content["model"])
        frames = check_count("frames", content["frames"], at_least=0)
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        reason = str(error).splitlines()[0] if isinstance(error, ConfigError) else repr(error)
        raise CheckpointError(
            f"The checkpoint at {path} is not that of a training ({reason[:200]})."
        ) from error
    return Agent(config, frames, model, _run_dir(path))


def _check_shapes(config: TrainConfig, weights: dict[str, torch.Tensor]) -> None:
    """Compares the weights with those of a network that takes neither time nor memory to make.

    Otherwise a few bytes of a configuration could ask for layers of gigabytes.
    """
    expected = make_model(config, torch.device("meta")).state_dict()
    if weights.keys() != expected.keys():
        raise ValueError("its weights are not those of the network in its configuration")
    for name, weight in weights.items():
        if weight.shape != expected[name].shape:
            raise ValueError(
                f"{name} has shape {tuple(weight.shape)}, not {tuple(expected[name].shape)}"
            )


def _run_dir(path: Path) -> Path | None:
    if path.is_dir():
        return path
    is_in_run = path.resolve().parent.name == CHECKPOINTS
    return path.resolve().parent.parent if is_in_run else None
