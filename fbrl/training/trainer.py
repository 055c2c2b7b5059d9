"""A training run from its configuration to its last checkpoint."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.agent import keep_density, make_model, make_training_reward
from fbrl.checkpoint import load_checkpoint
from fbrl.collect.ray_cluster import connected_to_ray, workers_and_cpus
from fbrl.collect.watchdog import Watchdog
from fbrl.config import TrainConfig
from fbrl.config_json import save_config
from fbrl.device import choose_device
from fbrl.envs.engine import load_gfootball
from fbrl.envs.process_vector_env import MatchWorkersError
from fbrl.evaluation.evaluation import Evaluation
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.update import TrainingDivergedError
from fbrl.run_files import CONFIG_NAME
from fbrl.training.crash_report import CrashReport, set_crash_report_aside
from fbrl.training.evaluator import Evaluator
from fbrl.training.interrupt import Interrupt, Interrupted
from fbrl.training.run_checkpoints import RunCheckpoints
from fbrl.training.run_dir import RunDirLock, RunDirReplacedError, existing_run_dir, make_run_dir
from fbrl.training.training_matches import training_matches
from fbrl.training.training_state import TrainingState, check_resumable, crashes_before, has_matches

HUNG = 1
"""Exit code of a process in which the engine hangs."""


@dataclass(frozen=True)
class TrainListener:
    """What to call as a training goes on; by default nothing, but for the warnings.

    Attributes:
        on_start: With the run's directory, the device, and the frames that were done before, once
            they are there.
        on_metrics: With the frames done and the metrics of each iteration.
        on_evaluation: With ``"untrained"``, ``"current"`` or ``"trained"``, matches done and
            matches wanted.
        on_postponed: When a signal has to wait until an update is finished.
        on_warning: With one line about what goes wrong without ending the training; by default
            a Python warning.
        on_hang: With one line when the engine hangs, in a thread of its own, just before the
            process is ended; by default it is printed on stderr.
    """

    on_start: Callable[[Path, torch.device, int], None] = lambda run_dir, device, frames: None
    on_metrics: Callable[[int, Mapping[str, float]], None] = lambda frames, metrics: None
    on_evaluation: Callable[[str, int, int], None] = lambda which, done, wanted: None
    on_postponed: Callable[[], None] = lambda: None
    on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=2)
    on_hang: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class TrainResult:
    """How a training ended.

    Attributes:
        run_dir: Where everything is.
        frames: Frames trained on.
        interrupted: A signal stopped it before its end.
        untrained: The evaluation before the training, where one was asked for.
        trained: The evaluation after it, unless it was interrupted or none was asked for.
    """

    run_dir: Path
    frames: int
    interrupted: bool
    untrained: Evaluation | None
    trained: Evaluation | None


def train(
    config: TrainConfig, listener: TrainListener | None = None, *, resume: bool = False
) -> TrainResult:
    """Trains an agent; see :class:`fbrl.config.TrainConfig` for what can be decided.

    The run's directory gets ``config.json``, TensorBoard events, ``metrics.csv``,
    ``evaluations.csv`` and ``checkpoints/last.pt``. Ctrl-C, SIGTERM, SIGHUP and SIGUSR1 end the
    training with a checkpoint. If the engine hangs, it is saved and the process is ended with exit
    code 1, because a thread in the engine can't be ended otherwise.

    Args:
        config: The training.
        listener: Told what goes on.
        resume: Go on from the latest checkpoint in ``config.run_dir``, as if the training had
            never stopped. The configuration may differ from the one before in
            :data:`fbrl.config.CHANGEABLE_ON_RESUME`.

    Raises:
        ConfigError: A value is impossible, or the run's directory can't be used.
        CheckpointError: There is no checkpoint to go on from.
        UnknownNameError: There is no such scenario, reward or the like.
        EngineNotInstalledError: gfootball is missing.
        TrainingDivergedError: A loss is not finite; the last checkpoint is the one before.
        MatchWorkersError: Processes that play matches died too often; the training is saved.
        TrainingNotSavedError: The training ended, but the last checkpoint can't be written.
        RunDirReplacedError: The run's directory was deleted and is another training's now.
        OSError: A file of the run can't be made to begin with.
    """
    listener = listener or TrainListener()
    config.check()
    device = choose_device(config.device)
    torch.manual_seed(config.seed)
    model = make_model(config, device)
    if config.compile or config.cuda_graphs:
        model.compile_trunk(cuda_graphs=config.cuda_graphs)
    reward = make_training_reward(config, config.run_dir)
    load_gfootball()
    with contextlib.ExitStack() as stack:
        if config.collector == "ray":
            stack.enter_context(connected_to_ray())
            workers_and_cpus(config)
        run_dir = existing_run_dir(config) if resume else make_run_dir(config)
        config = dataclasses.replace(config, run_dir=run_dir)
        lock = stack.enter_context(contextlib.closing(RunDirLock(run_dir)))
        checkpoint, crash, crashes = None, None, 0
        if resume:
            checkpoint = load_checkpoint(run_dir, on_warning=listener.on_warning)
            check_resumable(checkpoint, config)
            crashes = crashes_before(checkpoint)
            crash = set_crash_report_aside(run_dir, crashes + 1)
            crashes += crash is not None
        save_config(config, run_dir / CONFIG_NAME)
        keep_density(reward, run_dir)
        crash_report = stack.enter_context(CrashReport(run_dir))
        frames = checkpoint["frames"] if checkpoint else None
        listener.on_start(run_dir, device, frames or 0)
        if crash:
            listener.on_warning(
                f"The training had crashed, see {crash}. It goes on from its last checkpoint with "
                "other matches and random numbers, so as not to end in the same crash."
            )
        if checkpoint and (config.collector == "ray" or not has_matches(checkpoint)):
            listener.on_warning(
                "The matches of Ray's workers are in no checkpoint: new ones begin, with the "
                "weights, the optimiser and the counters that were saved."
            )
        env, bookkeeping = stack.enter_context(
            training_matches(config, model, reward, listener.on_warning)
        )
        evaluator = Evaluator(config, reward, listener.on_warning, crashes)
        stack.enter_context(contextlib.closing(evaluator))
        interrupt = stack.enter_context(Interrupt(listener.on_postponed))
        ppo = PPO(env, model, config.ppo, bookkeeping, collect_ahead=config.collect_ahead)
        stack.callback(ppo.close)
        monitor = Monitor(run_dir, config, reward.part_names, listener.on_warning, checkpoint)
        state = TrainingState(config, ppo, env, monitor)
        checkpoints = RunCheckpoints(config, state, lock, interrupt, listener.on_warning, frames)

        def end_hung(matches: Sequence[str]) -> None:
            _end_hung(matches, config, state, checkpoints, crash_report, listener)

        stack.enter_context(Watchdog(config.hang_timeout, end_hung))
        if checkpoint:
            state.load_state_dict(checkpoint, after_crash=crash is not None)
        state.begin_batch()
        # From the start there is something to go on from; a damaged one is replaced, not kept.
        checkpoints.save_first()
        return _train(config, listener, state, checkpoints, evaluator, interrupt)


def _train(
    config: TrainConfig,
    listener: TrainListener,
    state: TrainingState,
    checkpoints: RunCheckpoints,
    evaluator: Evaluator,
    interrupt: Interrupt,
) -> TrainResult:
    ppo, monitor = state.ppo, state.monitor
    untrained = trained = None

    def evaluate(which: str, episodes: int) -> Evaluation:
        with interrupt.allowed():
            report = evaluator.play(
                ppo.model, episodes, lambda done: listener.on_evaluation(which, done, episodes)
            )
        checkpoints.keep_run_dir()
        monitor.log_evaluation(report.evaluation, ppo.frames, report.seconds, report.images)
        checkpoints.save_if_best(report.evaluation)
        checkpoints.save()
        return report.evaluation

    try:
        is_new = ppo.frames == 0 and state.evaluated_at is None
        if is_new and config.eval_untrained and config.eval_episodes:
            untrained = evaluate("untrained", config.eval_episodes)

        while ppo.frames < config.ppo.total_frames:
            if evaluation_is_due(config, ppo.frames, state.evaluated_at or 0):
                evaluate("current", config.interim_eval_episodes)
            started = time.perf_counter()
            with interrupt.allowed():
                batch = ppo.collect(before_next=state.begin_batch)
            collected = time.perf_counter()
            losses = ppo.learn(batch)
            learned = time.perf_counter()
            checkpoints.keep_run_dir()
            metrics = monitor.log_iteration(
                ppo.frames, batch, losses, collected - started, learned - collected
            )
            if not config.collect_ahead:
                state.begin_batch()
            listener.on_metrics(ppo.frames, metrics)
            if keep_is_due(config, ppo.frames):
                checkpoints.keep()
            if checkpoints.is_due():
                checkpoints.save()

        checkpoints.save()
        if config.eval_episodes and state.evaluated_at != ppo.frames:
            trained = evaluate("trained", config.eval_episodes)
    except Interrupted:
        checkpoints.save()
    except MatchWorkersError:
        checkpoints.save()
        raise
    except TrainingDivergedError as error:
        raise checkpoints.save_divergence(error) from error
    checkpoints.check_saved()
    run_dir = checkpoints.run_dir
    return TrainResult(run_dir, ppo.frames, interrupt.requested, untrained, trained)


def _end_hung(
    matches: Sequence[str],
    config: TrainConfig,
    state: TrainingState,
    checkpoints: RunCheckpoints,
    crash_report: CrashReport,
    listener: TrainListener,
) -> None:
    """Saves the training as it was at the beginning of the batch, and ends the process."""
    reason = f"The engine hangs: {', '.join(matches)} took more than {config.hang_timeout} s."
    try:
        # Also the mark by which the training goes on with other matches.
        crash_report.write(reason)
        if state.has_begun:
            checkpoints.save()
    except (OSError, RunDirReplacedError) as error:
        listener.on_warning(str(error))
    finally:
        listener.on_hang(f"{reason} See {crash_report.path}; {checkpoints.what_is_saved()}.")
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
