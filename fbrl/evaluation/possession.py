"""Where a trained agent has the ball: matches played for :mod:`fbrl.figures.pitch`."""

from __future__ import annotations

import contextlib
import csv
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from fbrl.agent import load_agent
from fbrl.envs import make_env
from fbrl.evaluation.evaluation import other_seed, play_matches
from fbrl.transforms.ball_control import in_control

_KEYS = ("ball", "ball_owned_team", "ball_owned_player", "active")


def ball_positions(
    run: Path,
    matches: int,
    *,
    seed: int = 0,
    num_envs: int = 8,
    on_progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Plays matches with a run's latest agent and keeps the ball's positions while it has it.

    Args:
        run: the directory of a run, or a checkpoint.
        matches: how many matches at least, see :func:`fbrl.evaluation.evaluation.play_matches`.
        seed: seeds the matches and the sampled actions; if it is that of the training, matches are
            played that are not those that it began with.
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
        env = make_env(
            agent.config.scenario,
            num_envs=min(num_envs, matches),
            reward="scoring",
            observation=agent.config.observation,
            keep_keys=_KEYS,
            seed=other_seed(seed) if seed == agent.config.seed else seed,
        )
        stack.callback(env.close)
        torch.manual_seed(seed)
        policy = agent.model.get_collection_policy()
        for following, counted in play_matches(env, policy, matches):
            wanted = in_control({key: following[key] for key in _KEYS}) & counted
            positions.append(following["ball"][wanted, :2])
            finished += int((following["done"].squeeze(-1) & counted).sum())
            if on_progress is not None:
                on_progress(finished)
    return torch.cat(positions).double().numpy()


def write_positions(path: str | os.PathLike[str], positions: NDArray[np.float64]) -> None:
    """Writes positions as a CSV table with the columns x and y in pitch units."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["x", "y"])
        table.writerows([f"{x:.5f}", f"{y:.5f}"] for x, y in positions)


def read_positions(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Reads positions from a CSV table with the columns x and y in pitch units.

    Returns:
        (n, 2) positions.

    Raises:
        ValueError: a column is missing, a value is no finite number, or there is no row.
        OSError: the file cannot be read.
    """
    with Path(path).open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        try:
            rows = [(float(row["x"]), float(row["y"])) for row in reader]
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise ValueError(
                f"{path}, line {reader.line_num}: no position ({type(error).__name__}: {error}). "
                "Expected the columns x and y in pitch units, [-1, 1] x [-0.42, 0.42]."
            ) from error
    positions = np.array(rows, dtype=np.float64).reshape(-1, 2)
    if not len(positions) or not np.isfinite(positions).all():
        raise ValueError(f"{path} holds no positions, or some that are not finite numbers.")
    return positions
