"""The checkpoints of a training that is going on, in its run's directory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fbrl.assembly import keep_density
from fbrl.checkpoint import save_checkpoint
from fbrl.config import TrainConfig
from fbrl.config_json import config_to_dict, save_config
from fbrl.evaluation.evaluation import Evaluation
from fbrl.ppo.update import TrainingDivergedError
from fbrl.run_files import (
    BEST_NAME,
    CHECKPOINT_NAME,
    CONFIG_NAME,
    DIVERGED_NAME,
    PREVIOUS_NAME,
    kept_checkpoint_name,
)
from fbrl.training.faults import Interrupt
from fbrl.training.run_dir import RunDirLock
from fbrl.training.training_state import TrainingState
from fbrl.transforms import ScoringReward


class TrainingNotSavedError(RuntimeError):
    """Raised at the end of a training that is not saved as it is."""


@dataclass
class RunCheckpoints:
    """Saves a training when it is due, and as well as its disk allows.

    A checkpoint that can't be written ends no training: those before stay as they are, one warning
    says so, and after each update it is tried again. A directory that somebody deleted is made
    anew, with the configuration and the reward's densities.

    Attributes:
        saved_frames: Frames of the latest checkpoint that is there; None where there is none.
        failure: Why the latest checkpoint could not be written; None if it was.
    """

    config: TrainConfig
    state: TrainingState
    reward: ScoringReward
    lock: RunDirLock
    interrupt: Interrupt
    on_warning: Callable[[str], None]
    saved_frames: int | None = None
    failure: OSError | None = None

    @property
    def run_dir(self) -> Path:
        """The run's directory."""
        return self.lock.run_dir

    def save_first(self) -> None:
        """Saves the training as it begins or goes on; a damaged checkpoint is not kept.

        Raises:
            OSError: The checkpoint can't be written: nothing is lost yet.
        """
        self._write(CHECKPOINT_NAME)
        self.saved_frames = self.state.ppo.frames

    def keep_run_dir(self) -> None:
        """Makes the run's directory anew, to be saved into next, if somebody deleted it.

        Raises:
            RunDirReplacedError: Another training was begun in its place.
        """
        path = self.run_dir / CONFIG_NAME
        try:
            self.lock.renew()
            if path.exists():
                return
            save_config(self.config, path)
            keep_density(self.reward, self.run_dir)
        except OSError:  # whatever can't be written there says so
            return
        self.saved_frames = None
        self.on_warning(
            f"The run directory {self.run_dir} was deleted or emptied. It is made anew, without "
            "what was in it, and the training goes on there."
        )

    def is_due(self) -> bool:
        """Whether there is more to lose than the configuration allows."""
        saved, frames = self.saved_frames, self.state.ppo.frames
        return saved is None or frames - saved >= self.config.checkpoint_interval

    def save(self) -> None:
        """Saves the training, or warns that it can't be saved at present.

        Raises:
            RunDirReplacedError: Another training was begun in the place of its directory.
        """
        self.keep_run_dir()
        failed_before, frames = self.failure is not None, self.state.ppo.frames
        try:
            self._write(CHECKPOINT_NAME, self.run_dir / PREVIOUS_NAME)
        except OSError as error:
            self.failure = error
            if not failed_before:
                self.on_warning(
                    f"The checkpoint of {frames:,} frames can't be written ({error}). The "
                    f"training goes on and tries again; {self.what_is_saved()}."
                )
            return
        self.saved_frames, self.failure = frames, None
        if failed_before:
            self.on_warning(f"Checkpoints can be written again: {self.what_is_saved()}.")

    def save_hung(self, timeout: float) -> None:
        """Saves a training that hangs, unless the update in hand takes longer than the timeout."""
        if self.state.lock.acquire(timeout=timeout) and self.state.batch_start:
            self.save()

    def save_if_best(self, evaluation: Evaluation) -> None:
        """Remembers an evaluation, and keeps the training as its best so far if it says so."""
        state, before = self.state, self.state.best_goal_difference
        state.evaluated_at = state.ppo.frames
        if before is None or evaluation.goal_difference > before:
            state.best_goal_difference = evaluation.goal_difference
            if not self._write_or_warn(BEST_NAME):
                # What is there is still the best that is saved.
                state.best_goal_difference = before

    def keep(self) -> None:
        """Saves the training into a file that stays."""
        self._write_or_warn(kept_checkpoint_name(self.state.ppo.frames))

    def check_saved(self) -> None:
        """Makes sure, at the end, that nothing is lost.

        Raises:
            TrainingNotSavedError: The last checkpoint could not be written.
        """
        if self.failure is not None:
            raise TrainingNotSavedError(
                f"The training ended after {self.state.ppo.frames:,} frames, but could not be "
                f"saved ({self.failure}): {self.what_is_saved()}. Make room in {self.run_dir} "
                "and go on from there."
            ) from self.failure

    def save_divergence(self, error: TrainingDivergedError) -> TrainingDivergedError:
        """Saves what led to losses that are not finite, and returns the error that says where."""
        ppo, path = self.state.ppo, self.run_dir / DIVERGED_NAME
        try:
            save_checkpoint(
                path,
                config=config_to_dict(self.config),
                frames=ppo.frames,
                model=ppo.model.state_dict(),
                optimizer=ppo.optimizer.state_dict(),
                minibatch=error.minibatch.detach().cpu().to_dict(),
                losses=error.losses,
                message=str(error),
            )
            evidence = f"The minibatch and the network that led to it are in {path}"
        except OSError as failure:
            evidence = f"What led to it could not be saved ({failure})"
        message = f"{error} {evidence}; {self.what_is_saved()}."
        return TrainingDivergedError(message, error.minibatch, error.losses)

    def what_is_saved(self) -> str:
        """How much of the training is saved, in words."""
        if self.saved_frames is None:
            return "nothing of it is saved"
        return f"the last checkpoint, of {self.saved_frames:,} frames, is whole"

    def _write(self, name: str, keep_as: Path | None = None) -> None:
        with self.state.lock, self.interrupt.saving():
            save_checkpoint(self.run_dir / name, keep_as=keep_as, **self.state.state_dict())

    def _write_or_warn(self, name: str) -> bool:
        try:
            self._write(name)
        except OSError as error:
            path = self.run_dir / name
            self.on_warning(f"{path} can't be written ({error}). The training goes on without.")
            return False
        return True
