"""Everything that a training needs to go on exactly where it stopped."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fbrl.checkpoint import CheckpointError, load_checkpoint
from fbrl.config import CHANGEABLE_ON_RESUME, ConfigError, TrainConfig
from fbrl.config_json import config_from_dict, config_to_dict
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.run_seeds import seed_after_crashes

_DICTIONARIES = ("config", "model", "optimizer", "next_step", "random_numbers", "monitor")
_KINDS: dict[str, Any] = {
    **dict.fromkeys(_DICTIONARIES, dict),
    **dict.fromkeys(("matches", "kept_states"), list),
    **dict.fromkeys(("frames", "crashes"), int),
    "evaluated_at": int | None,
    "best_goal_difference": float | None,
}
"""What a training goes on from, and what each is."""

_ABSENT_BEFORE: dict[str, Any] = {"crashes": 0, "kept_states": []}
"""What checkpoints had not always, and what it was then."""


@dataclass(frozen=True)
class SavedTraining:
    """A training as a checkpoint has it: what :meth:`TrainingState.state_dict` returned."""

    state: Mapping[str, Any]

    @classmethod
    def load(
        cls,
        run_dir: Path,
        config: TrainConfig,
        on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=3),
    ) -> SavedTraining:
        """Reads the latest checkpoint of a run, to go on as a configuration says.

        Raises:
            CheckpointError: There is none, or it is only good for its policy.
            ConfigError: The configuration differs in what can't be changed, or the training has
                gone further than it asks for.
        """
        state = load_checkpoint(run_dir, on_warning=on_warning)
        if "matches" not in state:
            raise CheckpointError(
                "The checkpoint was written by an older version of fbrl, without the state of the "
                "matches: it can be evaluated and watched, but no training can go on from it."
            )
        state = {**_ABSENT_BEFORE, **state}
        for name, kind in _KINDS.items():
            if name not in state:
                raise CheckpointError(
                    f"The checkpoint has no {name}: no training can go on from it."
                )
            if not isinstance(state[name], kind) or (kind is int and state[name] < 0):
                raise CheckpointError(f"The checkpoint has {state[name]!r:.80} as {name}.")
        before, now = _flat(config_from_dict(state["config"])), _flat(config)
        for name in before:
            if name not in ("run_dir", *CHANGEABLE_ON_RESUME) and before[name] != now[name]:
                raise ConfigError(
                    f"{name} is {now[name]}, but the training had {before[name]}. When it "
                    f"goes on, only these may change: {', '.join(CHANGEABLE_ON_RESUME)}."
                )
        if config.ppo.frames_of_batches < state["frames"]:
            raise ConfigError(
                f"total_frames is {config.ppo.total_frames}, but the training has had "
                f"{state['frames']} frames already."
            )
        return cls(state)

    @property
    def frames(self) -> int:
        """Frames that had been learned from."""
        return int(self.state["frames"])

    @property
    def crashes(self) -> int:
        """How often the training had gone on after a crash."""
        return int(self.state["crashes"])

    @property
    def has_matches(self) -> bool:
        """Whether there is any trace of its matches; those of Ray's workers have none."""
        return bool(self.state["matches"] or self.state["next_step"])

    def is_finished(self, config: TrainConfig) -> bool:
        """Whether the training, and the evaluation at its end, are done."""
        is_evaluated = not config.eval_episodes or self.state["evaluated_at"] == self.frames
        return self.frames >= config.ppo.total_frames and is_evaluated


@dataclass
class TrainingState:
    """Gathers the state of a training, and puts a training into a state.

    A batch that is broken off has moved the matches and the random numbers on, but nothing has
    been learned from it. :meth:`begin_batch` remembers where they were, so that the same batch is
    collected when the training goes on.

    Attributes:
        ppo: What has been learned, and what collects.
        monitor: What has been logged.
        crashes: How often the training has gone on after a crash.
        evaluated_at: Frames learned from at the last evaluation that was finished; None before.
        best_goal_difference: The highest mean of an evaluation so far; None before the first.
        lock: Held while the state is not that of one moment, and while it is saved.
        batch_start: The matches and the random numbers that the batch begins with; empty before.
    """

    config: TrainConfig
    ppo: PPO
    monitor: Monitor
    crashes: int = 0
    evaluated_at: int | None = None
    best_goal_difference: float | None = None
    lock: Any = field(default_factory=threading.RLock)
    batch_start: Mapping[str, Any] = field(default_factory=dict)

    def begin_batch(self) -> None:
        """Remembers the matches and the random numbers, which the next batch begins with."""
        on_gpu = self.ppo.device.type == "cuda"
        self.batch_start = {
            **self.ppo.collector.state_dict(),
            "random_numbers": {
                "cpu": torch.get_rng_state(),
                "cuda": torch.cuda.get_rng_state(self.ppo.device) if on_gpu else None,
            },
        }

    def state_dict(self) -> dict[str, Any]:
        """The state at the beginning of the batch, as a checkpoint takes it."""
        start = self.batch_start
        return {
            "config": config_to_dict(self.config),
            **self.ppo.state_dict(),
            **start,
            "matches": _with_engines(start["matches"], _to_tensor),
            "kept_states": _with_engines(start["kept_states"], _to_tensor),
            "monitor": self.monitor.state_dict(),
            "crashes": self.crashes,
            "evaluated_at": self.evaluated_at,
            "best_goal_difference": self.best_goal_difference,
        }

    def go_on(self, saved: SavedTraining) -> None:
        """Goes on from what was saved; the monitor was given it before.

        After a crash since then, other matches and random numbers follow: the same ones would end
        in the same crash. Other matches follow, too, where none were saved, as of Ray's workers.

        Raises:
            CheckpointError: It is not that of such a training.
        """
        state, collector, seed = saved.state, self.ppo.collector, self.config.seed
        has_crashed = self.crashes > saved.crashes
        try:
            self.evaluated_at = state["evaluated_at"]
            self.best_goal_difference = state["best_goal_difference"]
            self.ppo.load_state_dict(state)
            if has_crashed:
                seed = seed_after_crashes(seed, self.crashes)
                torch.manual_seed(seed)
            else:
                self._load_random_numbers(state["random_numbers"])
                # The training's own seed would begin its first matches again.
                entropy = np.random.SeedSequence([seed, self.crashes, saved.frames])
                seed = int(entropy.generate_state(1)[0])
            if has_crashed or self.config.collector == "ray" or not saved.has_matches:
                collector.set_seed(seed)
                collector.reset()
            else:
                collector.load_state_dict(
                    {
                        "matches": _with_engines(state["matches"], _to_bytes),
                        "kept_states": _with_engines(state["kept_states"], _to_bytes),
                        "next_step": state["next_step"],
                    }
                )
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise CheckpointError(
                f"The checkpoint is not that of this training ({error!r:.200})."
            ) from error

    def _load_random_numbers(self, state: Mapping[str, Any]) -> None:
        torch.set_rng_state(state["cpu"])
        # On another kind of device the numbers that follow are others in any case.
        if state["cuda"] is not None and self.ppo.device.type == "cuda":
            torch.cuda.set_rng_state(state["cuda"], self.ppo.device)


def _flat(config: TrainConfig) -> dict[str, Any]:
    values = config_to_dict(config)
    return values.pop("ppo") | values


def _with_engines(
    states: Sequence[Mapping[str, Any]], convert: Callable[[Any], Any]
) -> list[dict[str, Any]]:
    """The states of matches with the engine's own state in another type."""
    return [
        {**state, "match": {**state["match"], "engine": convert(state["match"]["engine"])}}
        for state in states
    ]


def _to_tensor(engine: bytes) -> torch.Tensor:
    # PyTorch reads no bytes without trusting the file.
    return torch.frombuffer(bytearray(engine), dtype=torch.uint8)


def _to_bytes(engine: torch.Tensor) -> bytes:
    return engine.numpy().tobytes()
