"""A trained agent, from the checkpoint of a run or of those that fbrl brings along."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.assembly import make_model
from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.checks import check_count
from fbrl.config import ConfigError, TrainConfig
from fbrl.config_json import config_from_dict, config_to_dict
from fbrl.density.controls import BUILT_IN
from fbrl.models.actor_critic import ActorCritic
from fbrl.pretrained import PREFIX, locate, pretrained_names
from fbrl.run_files import CHECKPOINTS


@dataclass(frozen=True)
class Agent:
    """A trained network and what it was trained with."""

    config: TrainConfig
    """How it was trained."""
    frames: int
    """Frames that it was trained on."""
    model: ActorCritic
    """The network, on the device that was asked for."""
    run_dir: Path | None = None
    """The directory of its run; None for a checkpoint that lies elsewhere."""


def load_agent(path: Path | str, device: torch.device | str = "cpu") -> Agent:
    """Loads the agent of a checkpoint.

    Args:
        path: A checkpoint, or the directory of a run, whose latest one is taken, or
            ``"pretrained:NAME"``, see :mod:`fbrl.pretrained`.
        device: Where the network goes.

    Raises:
        CheckpointError: There is none, it is damaged, or it is no training's.
        UnknownNameError: fbrl brings no agent of this name along.

    Examples:
        >>> agent = load_agent("pretrained:academy_3_vs_1_with_keeper")
        >>> agent.config.observation
        'players'
    """
    path, device = locate(path), torch.device(device)
    if str(path) in pretrained_names() and not path.exists():
        raise CheckpointError(f"There is no run {path} here. Is {PREFIX}{path} what you mean?")
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
    run_dir: Path | None = path
    if not path.is_dir():
        parent = path.resolve().parent
        run_dir = parent.parent if parent.name == CHECKPOINTS else None
    return Agent(config, frames, model, run_dir)


def save_agent(agent: Agent, path: Path | str) -> None:
    """Writes a checkpoint of the agent alone: its weights, and the configuration of its training.

    Raises:
        ConfigError: Its reward has densities from a file, without which it can't be evaluated.
        OSError: The file can't be written.
    """
    config = agent.config
    density = config.reward_options.get("density")
    if density is not None and density not in BUILT_IN:
        raise ConfigError(
            f"The agent's reward has densities of its own, from {density}, which no checkpoint "
            "holds. Pass on the directory of its run instead: that has everything."
        )
    began_with = config.initial_weights
    if not str(began_with).startswith(PREFIX):
        began_with = None
    config = dataclasses.replace(config, run_dir=None, initial_weights=began_with)
    weights = agent.model.state_dict()
    save_checkpoint(Path(path), config=config_to_dict(config), frames=agent.frames, model=weights)


def _check_shapes(config: TrainConfig, weights: dict[str, torch.Tensor]) -> None:
    """Refuses other weights before there is a network, for which a file may ask gigabytes."""
    expected = make_model(config, torch.device("meta")).state_dict()
    if weights.keys() != expected.keys():
        raise ValueError("its weights are not those of the network in its configuration")
    for name, weight in weights.items():
        if weight.shape != expected[name].shape:
            raise ValueError(
                f"{name} has shape {tuple(weight.shape)}, not {tuple(expected[name].shape)}"
            )
