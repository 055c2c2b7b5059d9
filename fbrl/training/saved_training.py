"""A checkpoint that a training goes on from, checked once, and what is asked of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fbrl.checkpoint import CheckpointError, load_checkpoint
from fbrl.config import CHANGEABLE_ON_RESUME, ConfigError, TrainConfig
from fbrl.config_json import config_from_dict, config_to_dict

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
    "crashes": int,
    "kept_states": list,
}
"""What a training goes on from, and what each is."""

_ABSENT_BEFORE: dict[str, Any] = {"crashes": 0, "kept_states": []}
"""What checkpoints had not always, and what it was then."""


@dataclass(frozen=True)
class SavedTraining:
    """A training as a checkpoint has it.

    Attributes:
        state: What :meth:`~fbrl.training.training_state.TrainingState.state_dict` returned.
    """

    state: Mapping[str, Any]

    @classmethod
    def load(
        cls,
        run_dir: Path,
        config: TrainConfig,
        on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=3),
    ) -> SavedTraining:
        """Reads the latest checkpoint of a run.

        Args:
            run_dir: The run's directory.
            config: How the training is to go on.
            on_warning: Called with one line if the checkpoint before had to be taken; by default
                a Python warning.

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
            is_count = name in ("frames", "crashes")
            if not isinstance(state[name], kind) or (is_count and state[name] < 0):
                raise CheckpointError(f"The checkpoint has {state[name]!r:.80} as {name}.")
        saved = cls(state)
        saved._check_config(config)
        return saved

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

    def _check_config(self, config: TrainConfig) -> None:
        before, now = _flat(config_from_dict(self.state["config"])), _flat(config)
        for name in before:
            if name not in ("run_dir", *CHANGEABLE_ON_RESUME) and before[name] != now[name]:
                raise ConfigError(
                    f"{name} is {now[name]}, but the training had {before[name]}. When it "
                    f"goes on, only these may change: {', '.join(CHANGEABLE_ON_RESUME)}."
                )
        if config.ppo.total_frames < self.frames:
            raise ConfigError(
                f"total_frames is {config.ppo.total_frames}, but the training has had "
                f"{self.frames} frames already."
            )


def _flat(config: TrainConfig) -> dict[str, Any]:
    values = config_to_dict(config)
    return values.pop("ppo") | values
