"""A training run from its configuration to its last checkpoint."""

from __future__ import annotations

import contextlib
import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.agent import make_model, make_training_reward
from fbrl.checkpoint import (
    BEST_NAME,
    CHECKPOINT_NAME,
    PREVIOUS_NAME,
    load_checkpoint,
    save_checkpoint,
)
from fbrl.config import ConfigError, TrainConfig, save_config
from fbrl.envs.engine import load_gfootball
from fbrl.envs.factory import make_env
from fbrl.evaluate import Evaluation
from fbrl.interrupt import Interrupt, Interrupted
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.evaluator import Evaluator
from fbrl.ppo.training_state import TrainingState, check_resumable
from fbrl.run_dir import existing_run_dir, locked_run_dir, make_run_dir


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
    """

    on_start: Callable[[Path, torch.device, int], None] = lambda run_dir, device, frames: None
    on_metrics: Callable[[int, Mapping[str, float]], None] = lambda frames, metrics: None
    on_evaluation: Callable[[str, int, int], None] = lambda which, done, wanted: None
    on_postponed: Callable[[], None] = lambda: None
    on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=2)


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
    ``evaluations.csv`` and ``checkpoints/last.pt``. Ctrl-C and SIGTERM end the training with a
    checkpoint.

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
        OSError: A file of the run can't be made, or a checkpoint can't be written.
    """
    listener = listener or TrainListener()
    config.check()
    device = choose_device(config.device)
    torch.manual_seed(config.seed)
    model = make_model(config, device)
    reward = make_training_reward(config)
    load_gfootball()
    run_dir = existing_run_dir(config) if resume else make_run_dir(config)
    config = dataclasses.replace(config, run_dir=run_dir)
    with contextlib.ExitStack() as stack:
        stack.enter_context(locked_run_dir(run_dir))
        checkpoint = None
        if resume:
            checkpoint = load_checkpoint(run_dir, on_warning=listener.on_warning)
            check_resumable(checkpoint, config)
        save_config(config, run_dir / "config.json")
        listener.on_start(run_dir, device, checkpoint["frames"] if checkpoint else 0)
        env = make_env(
            config.scenario,
            num_envs=config.ppo.num_envs,
            reward=reward,
            observation=config.observation,
            num_threads=config.num_threads,
            seed=config.seed,
        )
        stack.enter_context(contextlib.closing(env))
        evaluator = Evaluator(config, reward, listener.on_warning)
        stack.enter_context(contextlib.closing(evaluator))
        interrupt = stack.enter_context(Interrupt(listener.on_postponed))
        ppo = PPO(env, model, config.ppo)
        monitor = Monitor(run_dir, config, reward.part_names, listener.on_warning, checkpoint)
        state = TrainingState(config, ppo, env, monitor)
        if checkpoint:
            state.load_state_dict(checkpoint)
        state.begin_batch()
        # From the start there is something to go on from; a damaged one is replaced, not kept.
        save_checkpoint(run_dir / CHECKPOINT_NAME, **state.state_dict())
        return _train(config, run_dir, listener, state, evaluator, interrupt)


def _train(
    config: TrainConfig,
    run_dir: Path,
    listener: TrainListener,
    state: TrainingState,
    evaluator: Evaluator,
    interrupt: Interrupt,
) -> TrainResult:
    ppo, monitor = state.ppo, state.monitor
    untrained = trained = None

    def save(name: str = CHECKPOINT_NAME) -> None:
        previous = run_dir / PREVIOUS_NAME if name == CHECKPOINT_NAME else None
        with interrupt.saving():
            save_checkpoint(run_dir / name, keep_as=previous, **state.state_dict())

    def evaluate(which: str, episodes: int) -> Evaluation:
        with interrupt.allowed():
            report = evaluator.play(
                ppo.model, episodes, lambda done: listener.on_evaluation(which, done, episodes)
            )
        monitor.log_evaluation(report.evaluation, ppo.frames, report.seconds, report.images)
        if state.add_evaluation(report.evaluation):
            save(BEST_NAME)
        save()
        return report.evaluation

    try:
        is_new = ppo.frames == 0 and state.evaluated_at is None
        if is_new and config.eval_untrained and config.eval_episodes:
            untrained = evaluate("untrained", config.eval_episodes)

        saved_at = ppo.frames
        while ppo.frames < config.ppo.total_frames:
            if evaluation_is_due(config, ppo.frames, state.evaluated_at or 0):
                evaluate("current", config.interim_eval_episodes)
            started = time.perf_counter()
            with interrupt.allowed():
                batch = ppo.collect()
            collected = time.perf_counter()
            losses = ppo.learn(batch)
            learned = time.perf_counter()
            metrics = monitor.log_iteration(
                ppo.frames, batch, losses, collected - started, learned - collected
            )
            state.begin_batch()
            listener.on_metrics(ppo.frames, metrics)
            if keep_is_due(config, ppo.frames):
                save(f"checkpoints/{ppo.frames}.pt")
            if ppo.frames - saved_at >= config.checkpoint_interval:
                save()
                saved_at = ppo.frames

        save()
        if config.eval_episodes and state.evaluated_at != ppo.frames:
            trained = evaluate("trained", config.eval_episodes)
    except Interrupted:
        save()
    return TrainResult(run_dir, ppo.frames, interrupt.requested, untrained, trained)


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


def choose_device(name: str) -> torch.device:
    """The device of a name; ``"auto"`` is CUDA where there is one, else the CPU.

    Raises:
        ConfigError: There is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"device is {name!r}; it must be auto, cpu, cuda or cuda:1.") from error
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise ConfigError(
            f"device is {name!r}, but PyTorch finds {torch.cuda.device_count()} CUDA devices. "
            "Use --device cpu, or install a CUDA build of PyTorch and its driver."
        )
    if device.type not in ("cpu", "cuda"):
        raise ConfigError(f"device is {name!r}; it must be auto, cpu, cuda or cuda:1.")
    return device
