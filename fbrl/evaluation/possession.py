"""Where a trained agent has the ball: matches played for :mod:`fbrl.figures.pitch`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from fbrl.agent import load_agent
from fbrl.assembly import make_agent_env
from fbrl.evaluation.evaluation import play_matches
from fbrl.run_seeds import fresh_seed
from fbrl.transforms.ball_control import in_control

_KEYS = ("ball", "ball_owned_team", "ball_owned_player", "active")


def ball_positions(
    run: Path,
    episodes: int,
    *,
    seed: int = 0,
    num_envs: int = 8,
    on_progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Plays matches with a run's latest agent and keeps the ball's positions while it has it.

    Args:
        run: the directory of a run, or a checkpoint.
        episodes: how many matches at least, see :func:`fbrl.evaluation.evaluation.play_matches`.
        seed: seeds the matches, see :func:`fbrl.run_seeds.fresh_seed`, and the sampled actions.
        num_envs: matches at a time.
        on_progress: called with the number of matches finished so far.

    Returns:
        (n, 2) positions in pitch units, one for each step that ends with the controlled player
        having the ball.

    Raises:
        CheckpointError: there is no checkpoint of fbrl.
        EngineNotInstalledError: gfootball is missing.
    """
    positions: list[torch.Tensor] = []
    finished = 0
    with contextlib.ExitStack() as stack:
        stack.enter_context(torch.random.fork_rng(devices=[]))
        agent = load_agent(run)
        env = make_agent_env(
            agent.config,
            num_envs=min(num_envs, episodes),
            reward="scoring",
            keep_keys=_KEYS,
            seed=fresh_seed(agent.config, agent.config.scenario, seed),
        )
        stack.callback(env.close)
        torch.manual_seed(seed)
        policy = agent.model.get_collection_policy()
        for following, counted in play_matches(env, policy, episodes):
            wanted = in_control({key: following[key] for key in _KEYS}) & counted
            positions.append(following["ball"][wanted, :2])
            finished += int((following["done"].squeeze(-1) & counted).sum())
            if on_progress is not None:
                on_progress(finished)
    return torch.cat(positions).double().numpy()
