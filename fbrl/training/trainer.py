"""A training run from its configuration to its last checkpoint."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import torch

from fbrl.agent import load_agent
from fbrl.assembly import keep_density, make_collector, make_model, make_training_reward
from fbrl.collect.ray_cluster import connected_to_ray, workers_and_cpus
from fbrl.collect.watchdog import Watchdog
from fbrl.config import ConfigError, TrainConfig
from fbrl.config_json import save_config
from fbrl.device import choose_device
from fbrl.envs.engine import load_gfootball
from fbrl.models.actor_critic import ActorCritic
from fbrl.monitor import Monitor
from fbrl.ppo.algorithm import PPO
from fbrl.run_files import CONFIG_NAME
from fbrl.training.crash_report import CrashReport, set_crash_report_aside
from fbrl.training.evaluator import Evaluator
from fbrl.training.interrupt import Interrupt
from fbrl.training.listener import TrainListener, TrainResult
from fbrl.training.run_checkpoints import RunCheckpoints
from fbrl.training.run_dir import RunDirLock, existing_run_dir, make_run_dir, remove_false_start
from fbrl.training.saved_training import SavedTraining
from fbrl.training.training_loop import TrainingLoop
from fbrl.training.training_state import TrainingState


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
        MatchWorkersError: Ray's workers died too often; the training is saved.
        TrainingNotSavedError: The training ended, but the last checkpoint can't be written.
        RunDirReplacedError: The run's directory was deleted and is another training's now.
        OSError: A file of the run can't be made to begin with.
    """
    listener = listener or TrainListener()
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
        lock = stack.enter_context(contextlib.closing(RunDirLock(run_dir)))
        saved = crash = None
        if resume:
            saved = SavedTraining.load(run_dir, config, listener.on_warning)
            crash = set_crash_report_aside(run_dir, saved.crashes + 1)
        else:
            remove_false_start(run_dir)
        save_config(config, run_dir / CONFIG_NAME)
        keep_density(reward, run_dir)
        crash_report = stack.enter_context(CrashReport(run_dir))
        frames = saved.frames if saved else None
        listener.on_start(run_dir, device, frames or 0)
        if saved:
            _tell_what_does_not_go_on(saved, crash, config, listener)
        policy = model.get_collection_policy()
        collector = make_collector(config, policy, reward, listener.on_warning)
        stack.enter_context(contextlib.closing(collector))
        crashes = saved.crashes + (crash is not None) if saved else 0
        evaluator = Evaluator(config, reward, listener.on_warning, crashes)
        stack.enter_context(contextlib.closing(evaluator))
        interrupt = stack.enter_context(Interrupt(listener.on_postponed))
        ppo = PPO(collector, model, config.ppo)
        monitor = Monitor(
            run_dir,
            config,
            reward.part_names,
            listener.on_warning,
            saved.state if saved else None,
            config.logger,
        )
        stack.enter_context(contextlib.closing(monitor))
        state = TrainingState(config, ppo, monitor)
        checkpoints = RunCheckpoints(
            config, state, reward, lock, interrupt, listener.on_warning, frames
        )
        loop = TrainingLoop(
            config, listener, state, checkpoints, evaluator, interrupt, crash_report
        )
        stack.enter_context(Watchdog(config.hang_timeout, loop.end_hung))
        # While it watches: a batch that is collected ahead may hang at the end, too.
        stack.callback(collector.wait)
        if saved:
            state.go_on(saved, after_crash=crash is not None)
        state.begin_batch()
        # From the start there is something to go on from; a damaged one is replaced, not kept.
        checkpoints.save_first()
        return loop.run()


def _take_weights(model: ActorCritic, config: TrainConfig, path: str) -> None:
    """Begins with the weights of another training.

    Raises:
        CheckpointError: There is no agent at the path.
        ConfigError: Its network is another one, or reads something else.
    """
    other = load_agent(path)
    for name in ("observation", "observation_options", "network_name", "network_options", "mirror"):
        theirs, ours = getattr(other.config, name), getattr(config, name)
        if theirs != ours:
            raise ConfigError(
                f"initial_weights is {path}, whose {name} is {theirs}; here it is {ours}. It has "
                "to be the same: choose it as there, or leave initial_weights out."
            )
    model.load_state_dict(other.model.state_dict())


def _tell_what_does_not_go_on(
    saved: SavedTraining, crash: Path | None, config: TrainConfig, listener: TrainListener
) -> None:
    if crash:
        listener.on_warning(
            f"The training had crashed, see {crash}. It goes on from its last checkpoint with "
            "other matches and random numbers, so as not to end in the same crash."
        )
    if config.collector == "ray" or not saved.has_matches:
        listener.on_warning(
            "The matches of Ray's workers are in no checkpoint: new ones begin, with the weights, "
            "the optimiser and the counters that were saved."
        )
