"""The configuration of a training: what can be set, what it is by default, and what is allowed.

A field whose metadata says ``is_how`` decides where and how a training is run and watched, not what
is learned; one that says ``may_change`` may be another one when the training goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from fbrl.components import LOGGERS, MASKS, NETWORKS, OBSERVATIONS, PICTURES, REWARDS
from fbrl.registry import ConfigError, Registry, check_types, module_of
from fbrl.scenarios import LARGEST_FRAME_SKIP, check_scenario

LARGEST = 10**12
"""Of any number of frames, matches or seconds."""

_ONLY_WITH = {"num_workers": "ray", "collect_ahead": "threads", "midway_starts": "threads"}
"""The collector without which a field has no effect."""

_HOW = {"is_how": True, "may_change": True}
_MAY_CHANGE = {"may_change": True}


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of proximal policy optimisation (Schulman et al. 2017).

    The defaults were tuned on academy_3_vs_1_with_keeper: experiments/light_preset_3_vs_1.
    """

    total_frames: int = field(default=1_000_000, metadata=_MAY_CHANGE)
    """Frames of the whole training, over all matches; gfootball's own steps, of 100 ms."""
    num_envs: int = 8
    """Matches played side by side."""
    num_steps: int = 256
    """Steps that each match plays between two updates."""
    frame_skip: int = 1
    """Frames in each step. The action is played in the first of them, as a button is pressed once,
    and what is held stays held. gamma is that of a step, and so has to be smaller."""
    num_minibatches: int = 8
    """Minibatches that a batch of num_envs * num_steps steps is split into."""
    minibatch_size: int | None = None
    """Steps of a minibatch; if given, it is used instead of num_minibatches."""
    num_epochs: int = 4
    """Passes over each batch."""
    learning_rate: float = 1e-3
    """Adam's step size at the start."""
    anneal_learning_rate: bool = True
    """Let the learning rate fall linearly to 0 at total_frames."""
    gamma: float = 0.993
    """Discount of a step."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip_epsilon: float = 0.2
    """The policy's probability ratio is clipped to 1 plus or minus this."""
    target_kl: float | None = None
    """An epoch whose estimated divergence from the policy that collected the batch is larger on
    average is the batch's last one; by default all epochs are done."""
    entropy_coeff: float = 0.01
    """Weight of the entropy bonus at the start."""
    entropy_coeff_end: float | None = None
    """Its weight at total_frames, to which it goes linearly; by default it stays."""
    critic_coeff: float = 0.5
    """Weight of the value loss."""
    value_loss: Literal["l2", "huber"] = "l2"
    """How the critic's errors count: squared, or beyond 1 linearly."""
    max_grad_norm: float = 0.64
    """The gradient is scaled down to this norm."""
    normalize_reward: bool = False
    """Divide the rewards by the size of the returns so far, so that the critic learns as well from
    small ones."""
    normalize_advantage: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1."""

    @property
    def frames_per_batch(self) -> int:
        """Frames that are collected between two updates."""
        return self.steps_per_batch * self.frame_skip

    @property
    def steps_per_batch(self) -> int:
        """Steps that are collected between two updates; each has been decided once."""
        return self.num_envs * self.num_steps

    @property
    def num_batches(self) -> int:
        """Batches of the whole training; the last one may exceed ``total_frames``."""
        return math.ceil(self.total_frames / self.frames_per_batch)

    @property
    def frames_of_batches(self) -> int:
        """Frames of these batches, with which the training ends."""
        return self.num_batches * self.frames_per_batch

    @property
    def steps_per_minibatch(self) -> int:
        """Steps of a minibatch, however it is configured."""
        return self.minibatch_size or self.steps_per_batch // self.num_minibatches

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value of another type or out of range."""
        check_types(self)
        names = ["total_frames", "num_envs", "num_steps", "num_minibatches", "num_epochs"]
        _check(self, names, lambda number: 1 <= number <= LARGEST, f"in [1, {LARGEST:,}]")
        most = LARGEST_FRAME_SKIP
        _check(self, ("frame_skip",), lambda frames: 1 <= frames <= most, f"in [1, {most}]")
        names = ["learning_rate", "clip_epsilon", "critic_coeff", "max_grad_norm", "target_kl"]
        _check(self, names, lambda value: 0 < value < math.inf, "a number above 0")
        names = ["entropy_coeff", "entropy_coeff_end"]
        _check(self, names, lambda value: 0 <= value < math.inf, "at least 0")
        _check(self, ("gamma", "gae_lambda"), lambda value: 0 <= value <= 1, "in [0, 1]")
        batch = self.steps_per_batch
        allowed = f"in [2, {batch}], the batch"
        _check(self, ("minibatch_size",), lambda size: 2 <= size <= batch, allowed)
        if self.minibatch_size is None:
            most = batch // 2
            _check(self, ("num_minibatches",), lambda number: number <= most, f"at most {most}")


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides how a training goes; see :mod:`fbrl.presets` for where to begin.

    What it is made of is named: by one of fbrl's names, one that an installed package adds, or
    ``module:Class``, see :class:`fbrl.registry.Registry`. Options that are not given are those of
    the component itself.
    """

    scenario: str
    """Scenario to train on, such as academy_3_vs_1_with_keeper."""
    reward: str = "analytics"
    """What is maximised."""
    reward_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the reward, by their names."""
    observation: str = "simple115"
    """What the agent sees."""
    observation_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the observation."""
    mask: str | None = None
    """Which actions the agent may not choose; by default it may choose any."""
    mask_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the mask."""
    network: str | None = None
    """What reads the observation; by default impala for mini maps and pixels, and mlp
    for vectors."""
    network_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the network."""
    mirror: bool = False
    """Let the network see every state with the ball in the lower half of the pitch, mirrored where
    it is in the upper one."""
    initial_weights: str | None = None
    """Run, checkpoint or pretrained:NAME, whose weights this training begins with, as of an easier
    scenario; the network and the observation have to be the same. By default they are random. The
    frames of that training are not counted."""
    midway_starts: float = 0.0
    """Share of the matches of the training that begin in states which earlier ones came to. They
    count as frames, but not among the figures of matches, and no evaluation has any."""
    seed: int = 0
    """Seeds the matches, the network and the minibatches."""
    device: str = field(default="auto", metadata=_HOW)
    """Where the network runs: auto (CUDA if there is one), cpu, cuda or cuda:<index>."""
    num_threads: int | None = field(default=None, metadata=_HOW)
    """Threads that play the matches; by default one for each available core."""
    collector: Literal["threads", "ray"] = field(default="threads", metadata=_HOW)
    """Where the matches are played: threads of this process, or ray, workers on the nodes of a Ray
    cluster, which wants pip install 'fbrl[ray]'."""
    num_groups: int | None = field(default=None, metadata=_HOW)
    """Groups of matches that take turns: while the threads step one, the network looks at another.
    By default two, from 48 matches on three."""
    num_workers: int | None = field(default=None, metadata=_HOW)
    """Ray's workers; by default one for each node. They have to divide num_envs."""
    collect_ahead: bool = field(default=False, metadata=_MAY_CHANGE)
    """Collect the next batch while learning from one, with the weights of one update before. For a
    GPU that learns while the cores would be idle. Such a training can't be repeated exactly."""
    run_dir: Path | None = None
    """New directory for logs and checkpoints; by default one below runs/ that is named after
    the scenario, the reward, the preset, the seed and the time."""
    logger: tuple[str, ...] = field(default=(), metadata=_HOW)
    """Services that metrics are sent to as well: wandb, mlflow; wants pip install 'fbrl[wandb]' or
    'fbrl[mlflow]'. TensorBoard's events and tables are written in any case."""
    checkpoint_interval: int = field(default=100_000, metadata=_HOW)
    """Frames between two checkpoints."""
    checkpoint_keep_interval: int = field(default=0, metadata=_HOW)
    """Frames between two checkpoints that are kept for good, as checkpoints/<frames>.pt; 0 for
    none."""
    hang_timeout: int = field(default=120, metadata=_HOW)
    """Seconds that one step of a match may take before the training is saved and ended, because
    the engine hangs; 0 for any time. A step takes milliseconds."""
    eval_episodes: int = 200
    """Fresh matches played with the trained policy at the end; 0 for none. The presets play 16 of
    the scenarios that last 3000 steps."""
    eval_untrained: bool = False
    """Play as many with the untrained policy first."""
    eval_interval: int = field(default=100_000, metadata=_HOW)
    """Frames between two evaluations during the training, each over a quarter of eval_episodes; 0
    for none. The training itself stays the same. The presets take 500,000 for the scenarios that
    last 3000 steps."""
    eval_pictures: bool = True
    """With each evaluation, show in TensorBoard where the agent has the ball, and a short video of
    a match; wants pip install 'fbrl[analysis]'."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """Hyperparameters of PPO."""

    @property
    def interim_eval_episodes(self) -> int:
        """Fresh matches of an evaluation during the training."""
        return math.ceil(self.eval_episodes / 4)

    def check(self) -> None:
        """Raises :class:`ConfigError`, or ``UnknownNameError``, for an impossible value."""
        check_types(self)
        check_scenario(self.scenario)
        for _, registry, name, options in self.components():
            registry.check(name)
            registry.check_options(name, options)
        if self.mask is None and self.mask_options:
            raise ConfigError("mask_options are given, but there is no mask.")
        if self.network == "player_set" and self.observation in ("simple115", *PICTURES):
            raise ConfigError(
                f"The network player_set reads players, and the observation is {self.observation}. "
                "Add --observation players."
            )
        for name in self.logger:
            LOGGERS.check(name)
        _check(self, ("midway_starts",), lambda share: 0 <= share <= 1, "in [0, 1]")
        _check(self, ("seed",), lambda seed: 0 <= seed < 2**32, "in [0, 2**32 - 1]")
        names = ["num_threads", "num_groups", "num_workers", "checkpoint_interval"]
        _check(self, names, lambda number: 1 <= number <= LARGEST, f"in [1, {LARGEST:,}]")
        names = ["checkpoint_keep_interval", "hang_timeout", "eval_episodes", "eval_interval"]
        _check(self, names, lambda number: 0 <= number <= LARGEST, f"in [0, {LARGEST:,}]")
        for name, used_with in _ONLY_WITH.items():
            if getattr(self, name) and self.collector != used_with:
                raise ConfigError(f"{name} is only used with the collector {used_with}.")
        if self.collector == "ray" and self.ppo.num_envs % (self.num_workers or 1):
            raise ConfigError(
                f"num_workers is {self.num_workers}; to share {self.ppo.num_envs} matches "
                "(num_envs) out evenly to ray's workers it must divide them."
            )
        self.ppo.check()

    @property
    def network_name(self) -> str:
        """The network, also where none is named."""
        default = "impala" if self.observation in PICTURES else "mlp"
        return default if self.network is None else self.network

    @property
    def modules(self) -> tuple[str, ...]:
        """The modules of what is named as ``module:Class``."""
        names = [name for _, _, name, _ in self.components()]
        found = [module_of(name) for name in (*names, *self.logger)]
        return tuple(dict.fromkeys(module for module in found if module is not None))

    def components(self) -> Iterator[tuple[str, Registry, str, Mapping[str, Any]]]:
        """What a training is made of: kind, registry, name and options of each."""
        yield "reward", REWARDS, self.reward, self.reward_options
        yield "observation", OBSERVATIONS, self.observation, self.observation_options
        if self.mask is not None:
            yield "mask", MASKS, self.mask, self.mask_options
        yield "network", NETWORKS, self.network_name, self.network_options


def _check(
    config: Any, names: Iterable[str], is_allowed: Callable[[Any], bool], allowed: str
) -> None:
    """Checks the values of fields; those whose type allows it may be None."""
    for name in names:
        value = getattr(config, name)
        if value is not None and not is_allowed(value):
            raise ConfigError(f"{name} is {value!s:.100}; it must be {allowed}.")


def _fields_that(say: str) -> tuple[str, ...]:
    every = (*fields(PPOConfig), *fields(TrainConfig))
    return tuple(entry.name for entry in every if entry.metadata.get(say))


HOW_IT_IS_RUN = _fields_that("is_how")
"""Fields of what decides where and how a training is run and watched, not what is learned."""

CHANGEABLE_ON_RESUME = _fields_that("may_change")
"""Fields that may be changed when a training goes on; all the rest decides what it is."""
