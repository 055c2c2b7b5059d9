"""Batches, updates, evaluations and checkpoints in their order, up to the end of a training."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

from fbrl.collect.collector import MatchWorkersError
from fbrl.config import TrainConfig
from fbrl.evaluation.evaluation import Evaluation
from fbrl.ppo.update import TrainingDivergedError
from fbrl.training.crash_report import CrashReport
from fbrl.training.evaluator import Evaluator
from fbrl.training.interrupt import Interrupt, Interrupted
from fbrl.training.listener import TrainListener, TrainResult
from fbrl.training.run_checkpoints import RunCheckpoints
from fbrl.training.run_dir import RunDirReplacedError
from fbrl.training.training_state import TrainingState

HUNG = 1
"""Exit code of a process in which the engine hangs."""


@dataclass(frozen=True)
class TrainingLoop:
    """A training that is ready to begin, or to go on.

    Attributes:
        config: The training.
        listener: Told what goes on.
        state: Has what is trained, and what it begins with.
        checkpoints: Saves it.
        evaluator: Plays fresh matches.
        interrupt: Ends it on a signal.
        crash_report: Has the stacks of a crash, or of a hang.
    """

    config: TrainConfig
    listener: TrainListener
    state: TrainingState
    checkpoints: RunCheckpoints
    evaluator: Evaluator
    interrupt: Interrupt
    crash_report: CrashReport

    def run(self) -> TrainResult:
        """Trains up to the end, or up to a signal; see :func:`fbrl.training.train`."""
        config, state, checkpoints, ppo = self.config, self.state, self.checkpoints, self.state.ppo
        untrained = trained = None
        try:
            is_new = ppo.frames == 0 and state.evaluated_at is None
            if is_new and config.eval_untrained and config.eval_episodes:
                untrained = self._evaluate("untrained", config.eval_episodes)
            while ppo.frames < config.ppo.total_frames:
                if evaluation_is_due(config, ppo.frames, state.evaluated_at or 0):
                    self._evaluate("current", config.interim_eval_episodes)
                self._train_on_a_batch()
                if keep_is_due(config, ppo.frames):
                    checkpoints.keep()
                if checkpoints.is_due():
                    checkpoints.save()
            checkpoints.save()
            if config.eval_episodes and state.evaluated_at != ppo.frames:
                trained = self._evaluate("trained", config.eval_episodes)
        except Interrupted:
            checkpoints.save()
        except MatchWorkersError:
            checkpoints.save()
            raise
        except TrainingDivergedError as error:
            raise checkpoints.save_divergence(error) from error
        checkpoints.check_saved()
        is_interrupted = self.interrupt.requested
        return TrainResult(checkpoints.run_dir, ppo.frames, is_interrupted, untrained, trained)

    def _train_on_a_batch(self) -> None:
        state, ppo = self.state, self.state.ppo
        started, computed = time.perf_counter(), time.process_time()
        with self.interrupt.allowed():
            batch = ppo.collect()
            if ppo.frames + batch.numel() < self.config.ppo.total_frames:
                ppo.collector.begin_next()
        collected = time.perf_counter()
        cores = (time.process_time() - computed) / (collected - started)
        with state.lock:
            losses = ppo.learn(batch)
            learned = time.perf_counter()
            self.checkpoints.keep_run_dir()
            metrics = state.monitor.log_iteration(
                ppo.frames, batch, losses, collected - started, learned - collected, cores
            )
            state.begin_batch()
        self.listener.on_metrics(ppo.frames, metrics)

    def _evaluate(self, which: str, episodes: int) -> Evaluation:
        state, checkpoints = self.state, self.checkpoints
        with self.interrupt.allowed():
            # A batch in flight would use the evaluation's random numbers up.
            state.ppo.collector.wait()
            report = self.evaluator.play(
                state.ppo.model,
                episodes,
                lambda done: self.listener.on_evaluation(which, done, episodes),
            )
        checkpoints.keep_run_dir()
        state.monitor.log_evaluation(
            report.evaluation, state.ppo.frames, report.seconds, report.images
        )
        checkpoints.save_if_best(report.evaluation)
        checkpoints.save()
        return report.evaluation

    def end_hung(self, matches: Sequence[str]) -> None:
        """Saves the training as it was at the beginning of the batch, and ends the process.

        With a batch that is collected ahead, the end of the update meanwhile is waited for, as
        long as for a match.

        Args:
            matches: That hang, in words.
        """
        timeout = self.config.hang_timeout
        reason = f"The engine hangs: {', '.join(matches)} took more than {timeout} s."
        try:
            # Also the mark by which the training goes on with other matches.
            self.crash_report.write(reason)
            if self.state.lock.acquire(timeout=timeout) and self.state.has_begun:
                self.checkpoints.save()
        except (OSError, RunDirReplacedError) as error:
            self.listener.on_warning(str(error))
        finally:
            # Whatever can't be said: nothing else ends a process with a thread in the engine.
            try:
                saved = self.checkpoints.what_is_saved()
                self.listener.on_hang(f"{reason} See {self.crash_report.path}; {saved}.")
            finally:
                os._exit(HUNG)


def keep_is_due(config: TrainConfig, frames: int) -> bool:
    """Whether the batch that was learned from last reached a multiple of the interval.

    Args:
        config: The training.
        frames: Frames learned from so far.
    """
    interval = config.checkpoint_keep_interval
    return (
        bool(interval) and frames // interval > (frames - config.ppo.frames_per_batch) // interval
    )


def evaluation_is_due(config: TrainConfig, frames: int, evaluated_at: int) -> bool:
    """Whether a multiple of the interval was reached; the end has an evaluation of its own.

    Args:
        config: The training.
        frames: Frames learned from so far.
        evaluated_at: The same at the last evaluation, or at any time since.
    """
    interval = config.eval_interval
    if not (interval and config.eval_episodes) or frames >= config.ppo.total_frames:
        return False
    return frames // interval > evaluated_at // interval
