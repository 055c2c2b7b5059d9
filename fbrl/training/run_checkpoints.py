"""The checkpoints of a training that is going on, in its run's directory."""

from __future__ import annotations

from collections.abc import Callable
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
from fbrl.training.interrupt import Interrupt
from fbrl.training.run_dir import RunDirLock
from fbrl.training.training_state import TrainingState
from fbrl.transforms import ScoringReward


class TrainingNotSavedError(RuntimeError):
    """Raised at the end of a training that is not saved as it is."""


class RunCheckpoints:
    """Saves a training when it is due, and as well as its disk allows.

    A checkpoint that can't be written ends no training: those before stay as they are, one warning
    says so, and after each update it is tried again.

    Args:
        config: The training.
        state: What is saved.
        reward: The training's, whose densities are kept with the run.
        lock: Of the run's directory, which is made anew where somebody deleted it.
        interrupt: Breaks no saving off.
        on_warning: Called with one line when something can't be saved, and when it can again.
        saved_frames: Those of the checkpoint that the training goes on from.

    Attributes:
        run_dir: The run's directory.
        saved_frames: Frames learned from up to the latest checkpoint that is there; None where
            there is none.
    """

    def __init__(
        self,
        config: TrainConfig,
        state: TrainingState,
        reward: ScoringReward,
        lock: RunDirLock,
        interrupt: Interrupt,
        on_warning: Callable[[str], None],
        saved_frames: int | None = None,
    ) -> None:
        self.saved_frames = saved_frames
        self._config = config
        self.run_dir = lock.run_dir
        self._state = state
        self._reward = reward
        self._lock = lock
        self._interrupt = interrupt
        self._on_warning = on_warning
        self._failure: OSError | None = None

    def save_first(self) -> None:
        """Saves the training as it begins or goes on; a damaged checkpoint is not kept.

        Raises:
            OSError: The checkpoint can't be written: nothing is lost yet.
        """
        self._write(CHECKPOINT_NAME)
        self.saved_frames = self._state.ppo.frames

    def keep_run_dir(self) -> None:
        """Makes the run's directory anew, to be saved into next, if somebody deleted it.

        Raises:
            RunDirReplacedError: Another training was begun in its place.
        """
        path = self.run_dir / CONFIG_NAME
        try:
            self._lock.renew()
            if path.exists():
                return
            save_config(self._config, path)
            keep_density(self._reward, self.run_dir)
        except OSError:  # whatever can't be written there says so
            return
        self.saved_frames = None
        self._on_warning(
            f"The run directory {self.run_dir} was deleted or emptied. It is made anew, without "
            "what was in it, and the training goes on there."
        )

    def is_due(self) -> bool:
        """Whether there is more to lose than the configuration allows."""
        if self.saved_frames is None:
            return True
        return self._state.ppo.frames - self.saved_frames >= self._config.checkpoint_interval

    def save(self) -> None:
        """Saves the training, or warns that it can't be saved at present.

        Raises:
            RunDirReplacedError: Another training was begun in the place of its directory.
        """
        self.keep_run_dir()
        failed_before = self._failure is not None
        frames = self._state.ppo.frames
        try:
            self._write(CHECKPOINT_NAME, keep_as=PREVIOUS_NAME)
        except OSError as error:
            self._failure = error
            if not failed_before:
                self._on_warning(
                    f"The checkpoint of {frames:,} frames can't be written ({error}). The "
                    f"training goes on and tries again; {self.what_is_saved()}."
                )
            return
        self.saved_frames, self._failure = frames, None
        if failed_before:
            self._on_warning(f"Checkpoints can be written again: {self.what_is_saved()}.")

    def save_if_best(self, evaluation: Evaluation) -> None:
        """Keeps the training as its best so far if an evaluation says so."""
        before = self._state.best_goal_difference
        if self._state.add_evaluation(evaluation) and not self._write_or_warn(BEST_NAME):
            # What is there is still the best that is saved.
            self._state.best_goal_difference = before

    def keep(self) -> None:
        """Saves the training into a file that stays."""
        self._write_or_warn(kept_checkpoint_name(self._state.ppo.frames))

    def check_saved(self) -> None:
        """Makes sure, at the end, that nothing is lost.

        Raises:
            TrainingNotSavedError: The last checkpoint could not be written.
        """
        if self._failure is not None:
            raise TrainingNotSavedError(
                f"The training ended after {self._state.ppo.frames:,} frames, but could not be "
                f"saved ({self._failure}): {self.what_is_saved()}. Make room in {self.run_dir} "
                "and go on from there."
            ) from self._failure

    def save_divergence(self, error: TrainingDivergedError) -> TrainingDivergedError:
        """Saves what led to losses that are not finite, and returns the error that says where."""
        ppo, path = self._state.ppo, self.run_dir / DIVERGED_NAME
        try:
            save_checkpoint(
                path,
                config=config_to_dict(self._config),
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

    def _write(self, name: str, keep_as: str | None = None) -> None:
        previous = None if keep_as is None else self.run_dir / keep_as
        with self._state.lock, self._interrupt.saving():
            save_checkpoint(self.run_dir / name, keep_as=previous, **self._state.state_dict())

    def _write_or_warn(self, name: str) -> bool:
        path: Path = self.run_dir / name
        try:
            self._write(name)
        except OSError as error:
            self._on_warning(f"{path} can't be written ({error}). The training goes on without.")
            return False
        return True
