"""Everything that a training needs to go on exactly where it stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch

from fbrl.checkpoint import CheckpointError
from fbrl.config import CHANGEABLE_ON_RESUME, ConfigError, TrainConfig
from fbrl.config_json import config_from_dict, config_to_dict
from fbrl.evaluation.evaluation import Evaluation
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.run_seeds import seed_after_crashes


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

    def load_state_dict(self, state: Mapping[str, Any], *, after_crash: bool = False) -> None:
        """Goes on from a state; the monitor was given it before.

        Args:
            state: What :meth:`state_dict` returned.
            after_crash: Begin other matches, with other random numbers: the same ones would end
                in the same crash.

        Raises:
            CheckpointError: It is not that of such a training.
        """
        try:
            self._load(state)
            if after_crash:
                self.crashes += 1
                seed = seed_after_crashes(self._config.seed, self.crashes)
                torch.manual_seed(seed)
                self._begin_other_matches(seed)
            else:
                self._load_random_numbers(state)
                self._load_matches(state)
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise CheckpointError(
                f"The checkpoint is not that of this training ({error!r:.200})."
            ) from error

    def _load(self, state: Mapping[str, Any]) -> None:
        self.crashes = crashes_before(state)
        self.evaluated_at = state["evaluated_at"]
        self.best_goal_difference = state["best_goal_difference"]
        self.ppo.load_state_dict(state)

    def _begin_other_matches(self, seed: int) -> None:
        self.ppo.collector.set_seed(seed)
        self.ppo.collector.reset()

    def _load_matches(self, state: Mapping[str, Any]) -> None:
        if has_matches(state) and self._config.collector != "ray":
            # Before there were any, checkpoints had no entry for them.
            kept = state.get("kept_states", [])
            self.ppo.collector.load_state_dict(
                {
                    "matches": [_with_engine(match, _to_bytes) for match in state["matches"]],
                    "kept_states": [_with_engine(one, _to_bytes) for one in kept],
                    "next_step": state["next_step"],
                }
            )
        else:
            # Those of the training's own seed would be its first ones again.
            seeds = np.random.SeedSequence([self._config.seed, self.crashes, state["frames"]])
            self._begin_other_matches(int(seeds.generate_state(1)[0]))

    def _load_random_numbers(self, state: Mapping[str, Any]) -> None:
        torch.set_rng_state(state["random_numbers"]["cpu"])
        on_gpu = state["random_numbers"]["cuda"]
        # On another kind of device the numbers that follow are others in any case.
        if on_gpu is not None and self.ppo.device.type == "cuda":
            torch.cuda.set_rng_state(on_gpu, self.ppo.device)


_KINDS: dict[str, Any] = {
    "config": dict,
    "frames": int,
    "model": dict,
    "optimizer": dict,
    "next_step": dict,
    "matches": list,
    "random_numbers": dict,
    "monitor": dict,
    "evaluated_at": int | None,
    "best_goal_difference": float | None,
}
"""What a training goes on from, and what each is."""


def has_matches(state: Mapping[str, Any]) -> bool:
    """Whether a checkpoint has any trace of its matches.

    Those of Ray's workers have none.
    """
    return bool(state["matches"] or state["next_step"])


def crashes_before(state: Mapping[str, Any]) -> int:
    """How often the training of a checkpoint had gone on after a crash."""
    # Before crashes were counted there was no such entry.
    crashes = state.get("crashes", 0)
    if not isinstance(crashes, int) or crashes < 0:
        raise CheckpointError(f"The checkpoint has {crashes!r:.80} as crashes.")
    return crashes


def check_resumable(state: Mapping[str, Any], config: TrainConfig) -> None:
    """Checks that a training can go on from a checkpoint.

    Args:
        state: The checkpoint.
        config: How the training is to go on.

    Raises:
        CheckpointError: The checkpoint is only good for its policy.
        ConfigError: The configuration differs in what can't be changed, or the training has gone
            further than it asks for.
    """
    if "matches" not in state:
        raise CheckpointError(
            "The checkpoint was written by an older version of fbrl, without the state of the "
            "matches: it can be evaluated and watched, but no training can go on from it."
        )
    for name, kind in _KINDS.items():
        if name not in state:
            raise CheckpointError(f"The checkpoint has no {name}: no training can go on from it.")
        if not isinstance(state[name], kind) or (name == "frames" and state[name] < 0):
            raise CheckpointError(f"The checkpoint has {state[name]!r:.80} as {name}.")
    before, now = _flat(config_from_dict(state["config"])), _flat(config)
    for name in before:
        if name not in ("run_dir", *CHANGEABLE_ON_RESUME) and before[name] != now[name]:
            raise ConfigError(
                f"{name} is {now[name]}, but the training had {before[name]}. When it "
                f"goes on, only these may change: {', '.join(CHANGEABLE_ON_RESUME)}."
            )
    if config.ppo.total_frames < state["frames"]:
        raise ConfigError(
            f"total_frames is {config.ppo.total_frames}, but the training has had "
            f"{state['frames']} frames already."
        )


def _flat(config: TrainConfig) -> dict[str, Any]:
    values = config_to_dict(config)
    return values.pop("ppo") | values


def _with_engine(state: Mapping[str, Any], convert: Callable[[Any], Any]) -> dict[str, Any]:
    """The state of a match with the engine's own state in another type."""
    match = state["match"]
    return {**state, "match": {**match, "engine": convert(match["engine"])}}


def _to_tensor(engine: bytes) -> torch.Tensor:
    # PyTorch reads no bytes without trusting the file.
    return torch.frombuffer(bytearray(engine), dtype=torch.uint8)


def _to_bytes(engine: torch.Tensor) -> bytes:
    return engine.numpy().tobytes()
