"""A training run from its configuration to its last checkpoint."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.agent import load_agent
from fbrl.assembly import keep_density, make_collector, make_model, make_training_reward
from fbrl.collect.collector import MatchWorkersError
from fbrl.collect.ray_cluster import connected_to_ray, workers_and_cpus
from fbrl.collect.watchdog import Watchdog
from fbrl.config import ConfigError, TrainConfig
from fbrl.config_json import save_config
from fbrl.device import choose_device
from fbrl.envs.engine import load_gfootball
from fbrl.evaluation.evaluation import Evaluation
from fbrl.models.actor_critic import ActorCritic
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.update import TrainingDivergedError
from fbrl.run_files import CONFIG_NAME
from fbrl.training.evaluator import Evaluator
from fbrl.training.faults import (
    CrashReport,
    Interrupt,
    Interrupted,
    end_hung,
    set_crash_report_aside,
)
from fbrl.training.run_checkpoints import RunCheckpoints
from fbrl.training.run_dir import RunDirLock, existing_run_dir, make_run_dir, remove_false_start
from fbrl.training.training_state import SavedTraining, TrainingState


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

    To ``resume`` is to go on from the latest checkpoint in ``config.run_dir``, as if the training
    had never stopped; :data:`fbrl.config.CHANGEABLE_ON_RESUME` says what may change then.

    Raises:
        ConfigError: A value is impossible, or the run's directory can't be used.
        CheckpointError: There is no checkpoint to go on from.
        UnknownNameError: There is no such scenario, reward or the like.
        EngineNotInstalledError: gfootball is missing.
        TrainingDivergedError: A loss is not finite; the last checkpoint is the one before.
        MatchWorkersError: Ray's workers died too often; the training is saved.
        TrainingNotSavedError: The training ended, but the last checkpoint can't be written.
        RunDirReplacedError: The run's directory was deleted and is another training's now.
        OSError: A file of the run can't be made to begin with.
    """
    listener = listener or TrainListener()
    on_warning = listener.on_warning
    config.check()
    device = choose_device(config.device)
    torch.manual_seed(config.seed)
    model = make_model(config, device)
    if config.initial_weights is not None and not resume:
        _take_weights(model, config, config.initial_weights)
    reward = make_training_reward(config, config.run_dir if resume else None)
    load_gfootball()
    with contextlib.ExitStack() as stack:
        if config.collector == "ray":
            stack.enter_context(connected_to_ray())
            workers_and_cpus(config)
        run_dir = existing_run_dir(config) if resume else make_run_dir(config)
        config = dataclasses.replace(config, run_dir=run_dir)
        lock = RunDirLock(run_dir)
        stack.callback(lock.close)
        saved = crash = None
        if resume:
            saved = SavedTraining.load(run_dir, config, on_warning)
            crash = set_crash_report_aside(run_dir, saved.crashes + 1)
        else:
            remove_false_start(run_dir)
        save_config(config, run_dir / CONFIG_NAME)
        keep_density(reward, run_dir)
        crash_report = stack.enter_context(CrashReport(run_dir))
        listener.on_start(run_dir, device, saved.frames if saved else 0)
        if crash:
            on_warning(
                f"The training had crashed, see {crash}. It goes on from its last checkpoint with "
                "other matches and random numbers, so as not to end in the same crash."
            )
        if saved and (config.collector == "ray" or not saved.has_matches):
            on_warning(
                "The matches of Ray's workers are in no checkpoint: new ones begin, with the "
                "weights, the optimiser and the counters that were saved."
            )
        collector = make_collector(config, model.get_collection_policy(), reward, on_warning)
        stack.callback(collector.close)
        crashes = saved.crashes + (crash is not None) if saved else 0
        evaluator = Evaluator(config, reward, on_warning, crashes)
        stack.callback(evaluator.close)
        interrupt = stack.enter_context(Interrupt(listener.on_postponed))
        ppo = PPO(collector, model, config.ppo)
        before = saved.state if saved else None
        monitor = Monitor(run_dir, config, reward.part_names, on_warning, before, config.logger)
        stack.callback(monitor.close)
        state = TrainingState(config, ppo, monitor, crashes)
        checkpoints = RunCheckpoints(config, state, reward, lock, interrupt, on_warning)

        def on_hang(matches: Sequence[str]) -> None:
            end_hung(matches, config.hang_timeout, crash_report, checkpoints, listener.on_hang)

        stack.enter_context(Watchdog(config.hang_timeout, on_hang))
        # While it watches: a batch that is collected ahead may hang at the end, too.
        stack.callback(collector.wait)
        if saved:
            checkpoints.saved_frames = saved.frames
            state.go_on(saved)
        state.begin_batch()
        # From the start there is something to go on from; a damaged one is replaced, not kept.
        checkpoints.save_first()
        return TrainingLoop(config, listener, state, checkpoints, evaluator, interrupt).run()


def _take_weights(model: ActorCritic, config: TrainConfig, path: str) -> None:
    """Begins with the weights of another training, of the same network and observation."""
    other = load_agent(path)
    for name in ("observation", "observation_options", "network_name", "network_options", "mirror"):
        theirs, ours = getattr(other.config, name), getattr(config, name)
        if theirs != ours:
            raise ConfigError(
                f"initial_weights is {path}, whose {name} is {theirs}; here it is {ours}. It has "
                "to be the same: choose it as there, or leave initial_weights out."
            )
    model.load_state_dict(other.model.state_dict())


@dataclass(frozen=True)
class TrainingLoop:
    """Batches, updates, evaluations and checkpoints in their order, up to the end."""

    config: TrainConfig
    listener: TrainListener
    state: TrainingState
    checkpoints: RunCheckpoints
    evaluator: Evaluator
    interrupt: Interrupt

    def run(self) -> TrainResult:
        """Trains up to the end, or up to a signal; see :func:`train`."""
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
            if ppo.frames + ppo.config.frames_per_batch < ppo.config.total_frames:
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
            started = time.perf_counter()
            evaluation, images = self.evaluator.play(
                state.ppo.model,
                episodes,
                lambda done: self.listener.on_evaluation(which, done, episodes),
            )
            seconds = time.perf_counter() - started
        checkpoints.keep_run_dir()
        state.monitor.log_evaluation(evaluation, state.ppo.frames, seconds, images)
        checkpoints.save_if_best(evaluation)
        checkpoints.save()
        return evaluation


def keep_is_due(config: TrainConfig, frames: int) -> bool:
    """Whether the batch after which so many frames are learned from reached the interval."""
    interval, before = config.checkpoint_keep_interval, frames - config.ppo.frames_per_batch
    return interval > 0 and frames // interval > before // interval


def evaluation_is_due(config: TrainConfig, frames: int, evaluated_at: int) -> bool:
    """Whether a multiple of the interval was reached; the end has an evaluation of its own.

    ``frames`` have been learned from so far, ``evaluated_at`` at the last evaluation or since.
    """
    interval = config.eval_interval
    if not (interval and config.eval_episodes) or frames >= config.ppo.total_frames:
        return False
    return frames // interval > evaluated_at // interval
