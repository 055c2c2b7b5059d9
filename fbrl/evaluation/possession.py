"""Where a trained agent has the ball: matches played for :mod:`fbrl.figures.pitch`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from fbrl.agent import load_agent
from fbrl.assembly import make_agent_env
from fbrl.evaluation.evaluation import evaluate
from fbrl.run_seeds import fresh_seed
from fbrl.transforms.ball_control import in_control

POSSESSION_KEYS = ("ball", "ball_owned_team", "ball_owned_player", "active")
"""Raw observation keys that :class:`BallPositions` reads."""


class BallPositions:
    """Gathers where the ball is while the controlled player has it.

    To be passed to :func:`fbrl.evaluation.evaluation.evaluate` as ``on_step``, with an environment
    that keeps :data:`POSSESSION_KEYS`.
    """

    def __init__(self) -> None:
        self._positions: list[torch.Tensor] = []

    def __call__(self, following: TensorDictBase, counted: torch.Tensor) -> None:
        """Takes those of one step of several matches."""
        has_ball = in_control({key: following[key] for key in POSSESSION_KEYS}) & counted
        self._positions.append(following["ball"][has_ball, :2])

    def array(self) -> NDArray[np.float64]:
        """One for each step after which the controlled player has it, pitch units, (n, 2)."""
        return torch.cat(self._positions).double().cpu().numpy()


def ball_positions(
    run: Path,
    episodes: int,
    *,
    seed: int = 0,
    num_envs: int = 8,
    on_progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Where the ball is while an agent has it, see :meth:`BallPositions.array`.

    Args:
        run: The directory of a run, or a checkpoint.
        episodes: As for :func:`fbrl.evaluation.evaluation.evaluate`.
        seed: Of the matches, see :func:`fbrl.run_seeds.fresh_seed`, and of the sampled actions.
        num_envs: Matches at a time.
        on_progress: As there.

    Raises:
        CheckpointError: There is no checkpoint of fbrl.
        EngineNotInstalledError: gfootball is missing.
    """
    positions = BallPositions()
    with torch.random.fork_rng(devices=[]):
        agent = load_agent(run)
        env = make_agent_env(
            agent.config,
            num_envs=min(num_envs, episodes),
            reward="scoring",
            keep_keys=POSSESSION_KEYS,
            seed=fresh_seed(agent.config, agent.config.scenario, seed),
        )
        with contextlib.closing(env):
            torch.manual_seed(seed)
            policy = agent.model.get_collection_policy()
            evaluate(env, policy, episodes, on_progress=on_progress, on_step=positions)
    return positions.array()
