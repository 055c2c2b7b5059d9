"""A training run from its configuration to its last checkpoint."""

from __future__ import annotations

import contextlib
import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import torch

from fbrl.agent import make_model, make_training_reward
from fbrl.checkpoint import CHECKPOINT_NAME, save_checkpoint
from fbrl.config import ConfigError, TrainConfig, config_to_dict, save_config
from fbrl.envs.engine import load_gfootball
from fbrl.envs.factory import make_env
from fbrl.evaluate import Evaluation
from fbrl.interrupt import Interrupt, Interrupted
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.evaluator import Evaluator


@dataclass(frozen=True)
class TrainListener:
    """What to call as a training goes on; by default nothing, but for the warnings.

    Attributes:
        on_start: With the run's directory and the device, once they are there.
        on_metrics: With the frames done and the metrics of each iteration.
        on_evaluation: With ``"untrained"``, ``"current"`` or ``"trained"``, matches done and
            matches wanted.
        on_postponed: When a signal has to wait until an update is finished.
        on_warning: With one line about what goes wrong without ending the training; by default
            a Python warning.
    """

    on_start: Callable[[Path, torch.device], None] = lambda run_dir, device: None
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


def train(config: TrainConfig, listener: TrainListener | None = None) -> TrainResult:
    """Trains an agent; see :class:`fbrl.config.TrainConfig` for what can be decided.

    The run's directory gets ``config.json``, TensorBoard events, ``metrics.csv``,
    ``evaluations.csv`` and ``checkpoints/last.pt``. Ctrl-C and SIGTERM end the training with a
    checkpoint.

    Raises:
        ConfigError: A value is impossible, or the run's directory can't be used.
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
    run_dir = make_run_dir(config)
    save_config(dataclasses.replace(config, run_dir=run_dir), run_dir / "config.json")
    listener.on_start(run_dir, device)
    env = make_env(
        config.scenario,
        num_envs=config.ppo.num_envs,
        reward=reward,
        observation=config.observation,
        num_threads=config.num_threads,
        seed=config.seed,
    )
    evaluator = Evaluator(config, reward, listener.on_warning)
    untrained = trained = None
    with (
        contextlib.closing(env),
        contextlib.closing(evaluator),
        Interrupt(listener.on_postponed) as interrupt,
        PPO(env, model, config.ppo) as ppo,
    ):
        monitor = Monitor(run_dir, config, reward.part_names, listener.on_warning)

        def evaluate(which: str, episodes: int) -> Evaluation:
            with interrupt.allowed():
                report = evaluator.play(
                    model, episodes, lambda done: listener.on_evaluation(which, done, episodes)
                )
            monitor.log_evaluation(report.evaluation, ppo.frames, report.seconds, report.images)
            return report.evaluation

        try:
            if config.eval_untrained and config.eval_episodes:
                untrained = evaluate("untrained", config.eval_episodes)

            saved_at = evaluated_at = 0
            while ppo.frames < config.ppo.total_frames:
                started = time.perf_counter()
                with interrupt.allowed():
                    batch = ppo.collect()
                collected = time.perf_counter()
                losses = ppo.learn(batch)
                learned = time.perf_counter()
                metrics = monitor.log_iteration(
                    ppo.frames, batch, losses, collected - started, learned - collected
                )
                listener.on_metrics(ppo.frames, metrics)
                if ppo.frames - saved_at >= config.checkpoint_interval:
                    with interrupt.saving():
                        _save(run_dir, config, ppo)
                    saved_at = ppo.frames
                if evaluation_is_due(config, ppo.frames, evaluated_at):
                    evaluate("current", config.interim_eval_episodes)
                    evaluated_at = ppo.frames

            with interrupt.saving():
                _save(run_dir, config, ppo)
            if config.eval_episodes:
                trained = evaluate("trained", config.eval_episodes)
        except Interrupted:
            with interrupt.saving():
                _save(run_dir, config, ppo)
    return TrainResult(run_dir, ppo.frames, interrupt.requested, untrained, trained)


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


def make_run_dir(config: TrainConfig) -> Path:
    """Makes the directory of a run.

    Raises:
        ConfigError: It has something in it already, or can't be made.
    """
    run_dir = config.run_dir
    if run_dir is None:
        now = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{config.reward}-{config.preset}-seed{config.seed}-{now}"
        run_dir = Path("runs") / config.scenario / name
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        occupied = any(run_dir.iterdir())
    except OSError as error:
        raise ConfigError(f"The run directory {run_dir} can't be made: {error}.") from error
    if occupied:
        raise ConfigError(f"The run directory {run_dir} is not empty: choose a new one.")
    return run_dir


def _save(run_dir: Path, config: TrainConfig, ppo: PPO) -> None:
    save_checkpoint(
        run_dir / CHECKPOINT_NAME,
        config=config_to_dict(config),
        frames=ppo.frames,
        model=ppo.model.state_dict(),
        optimizer=ppo.optimizer.state_dict(),
    )
