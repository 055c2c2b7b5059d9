"""Everything that a training needs to go on exactly where it stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch

from fbrl.checkpoint import CheckpointError
from fbrl.config import TrainConfig
from fbrl.config_json import config_to_dict
from fbrl.evaluation.evaluation import Evaluation
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.run_seeds import seed_after_crashes
from fbrl.training.saved_training import SavedTraining


class TrainingState:
    """Gathers the state of a training, and puts a training into a state.

    A batch that is broken off has moved the matches and the random numbers on, but nothing has
    been learned from it. :meth:`begin_batch` remembers where they were, so that the same batch is
    collected when the training goes on.

    Args:
        config: The training.
        ppo: What has been learned, and what collects. Where that can't tell the state of its
            matches, the training goes on with others.
        monitor: What has been logged.

    Attributes:
        ppo, monitor: As they were given.
        crashes: How often the training has gone on after a crash.
        evaluated_at: Frames learned from at the last evaluation that was finished; None before.
        best_goal_difference: The highest mean of an evaluation so far; None before the first.
        lock: Held while the state is not that of one moment, and while it is saved.
    """

    def __init__(self, config: TrainConfig, ppo: PPO, monitor: Monitor) -> None:
        self.lock = threading.RLock()
        self.crashes = 0
        self.evaluated_at: int | None = None
        self.best_goal_difference: float | None = None
        self._config = config
        self.ppo = ppo
        self.monitor = monitor
        self._batch_start: dict[str, Any] = {}

    def begin_batch(self) -> None:
        """Remembers the matches and the random numbers, which the next batch begins with."""
        on_gpu = self.ppo.device.type == "cuda"
        self._batch_start = {
            **self.ppo.collector.state_dict(),
            "random_numbers": {
                "cpu": torch.get_rng_state(),
                "cuda": torch.cuda.get_rng_state(self.ppo.device) if on_gpu else None,
            },
        }

    @property
    def has_begun(self) -> bool:
        """Whether there is a batch to begin with, so that :meth:`state_dict` is whole."""
        return bool(self._batch_start)

    def add_evaluation(self, evaluation: Evaluation) -> bool:
        """Remembers that it was done, and says whether it is the best so far."""
        self.evaluated_at = self.ppo.frames
        best, latest = self.best_goal_difference, evaluation.goal_difference
        if best is not None and latest <= best:
            return False
        self.best_goal_difference = latest
        return True

    def state_dict(self) -> dict[str, Any]:
        """The state at the beginning of the batch, as a checkpoint takes it."""
        start = self._batch_start
        return {
            "config": config_to_dict(self._config),
            **self.ppo.state_dict(),
            **start,
            "matches": [_with_engine(match, _to_tensor) for match in start["matches"]],
            "kept_states": [_with_engine(kept, _to_tensor) for kept in start["kept_states"]],
            "monitor": self.monitor.state_dict(),
            "crashes": self.crashes,
            "evaluated_at": self.evaluated_at,
            "best_goal_difference": self.best_goal_difference,
        }

    def go_on(self, saved: SavedTraining, *, after_crash: bool = False) -> None:
        """Goes on from what was saved; the monitor was given it before.

        Args:
            saved: The training as it was.
            after_crash: Begin other matches, with other random numbers: the same ones would end
                in the same crash.

        Raises:
            CheckpointError: It is not that of such a training.
        """
        state = saved.state
        try:
            self.crashes = saved.crashes
            self.evaluated_at = state["evaluated_at"]
            self.best_goal_difference = state["best_goal_difference"]
            self.ppo.load_state_dict(state)
            if after_crash:
                self.crashes += 1
                seed = seed_after_crashes(self._config.seed, self.crashes)
                torch.manual_seed(seed)
                self._begin_other_matches(seed)
            else:
                self._load_random_numbers(state)
                self._load_matches(saved)
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise CheckpointError(
                f"The checkpoint is not that of this training ({error!r:.200})."
            ) from error

    def _begin_other_matches(self, seed: int) -> None:
        self.ppo.collector.set_seed(seed)
        self.ppo.collector.reset()

    def _load_matches(self, saved: SavedTraining) -> None:
        if saved.has_matches and self._config.collector != "ray":
            state = saved.state
            self.ppo.collector.load_state_dict(
                {
                    "matches": [_with_engine(match, _to_bytes) for match in state["matches"]],
                    "kept_states": [_with_engine(one, _to_bytes) for one in state["kept_states"]],
                    "next_step": state["next_step"],
                }
            )
        else:
            # Those of the training's own seed would be its first ones again.
            seeds = np.random.SeedSequence([self._config.seed, self.crashes, saved.frames])
            self._begin_other_matches(int(seeds.generate_state(1)[0]))

    def _load_random_numbers(self, state: Mapping[str, Any]) -> None:
        torch.set_rng_state(state["random_numbers"]["cpu"])
        on_gpu = state["random_numbers"]["cuda"]
        # On another kind of device the numbers that follow are others in any case.
        if on_gpu is not None and self.ppo.device.type == "cuda":
            torch.cuda.set_rng_state(on_gpu, self.ppo.device)


def _with_engine(state: Mapping[str, Any], convert: Callable[[Any], Any]) -> dict[str, Any]:
    """The state of a match with the engine's own state in another type."""
    match = state["match"]
    return {**state, "match": {**match, "engine": convert(match["engine"])}}


def _to_tensor(engine: bytes) -> torch.Tensor:
    # PyTorch reads no bytes without trusting the file.
    return torch.frombuffer(bytearray(engine), dtype=torch.uint8)


def _to_bytes(engine: torch.Tensor) -> bytes:
    return engine.numpy().tobytes()
