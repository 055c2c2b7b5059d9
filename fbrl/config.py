"""The configuration of a training: what can be set, what it is by default, and what is allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fbrl.checks.field_types import FieldTypeError, check_field_types
from fbrl.checks.names import check_name
from fbrl.envs.scenarios import check_scenario

PRESET_NAMES = ("light", "thesis")
REWARD_NAMES = ("analytics", "potential", "checkpoints", "scoring")
OBSERVATION_NAMES = ("minimap", "smm", "simple115", "players")
TRANSITION_NAMES = ("possession", "consecutive")
ACTIVATION_NAMES = ("relu", "tanh")
MASK_NAMES = ("engine", "expert")
NETWORK_NAMES = ("mlp", "player_set")
COLLECTOR_NAMES = ("threads", "ray")
LOGGER_NAMES = ("wandb", "mlflow")
_REWARD_OPTIONS = {
    "density": ("analytics", "potential"),
    "transition": ("analytics",),
    "episode_cap": ("analytics",),
}
HOW_IT_IS_RUN = (
    "device",
    "num_threads",
    "collector",
    "num_groups",
    "num_workers",
    "logger",
    "checkpoint_interval",
    "checkpoint_keep_interval",
    "eval_interval",
    "hang_timeout",
)
"""What decides where and how a training is run and watched, not what is learned."""

CHANGEABLE_ON_RESUME = ("total_frames", "collect_ahead", *HOW_IT_IS_RUN)
"""What may be changed when a training goes on; all the rest decides what it is."""


class ConfigError(ValueError):
    """Raised for a value that no training can be run with."""


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of proximal policy optimisation (Schulman et al. 2017)."""

    total_frames: int = 1_000_000
    """Environment steps of the whole training, over all matches."""

    num_envs: int = 8
    """Matches played side by side."""

    num_steps: int = 512
    """Steps that each match plays between two updates."""

    num_minibatches: int = 8
    """Minibatches that a batch of num_envs * num_steps frames is split into."""

    minibatch_size: int | None = None
    """Frames of a minibatch; if given, it is used instead of num_minibatches."""

    num_epochs: int = 2
    """Passes over each batch."""

    learning_rate: float = 3.43e-4
    """Adam's step size at the start."""

    anneal_learning_rate: bool = True
    """Let the learning rate fall linearly to 0 at total_frames."""

    gamma: float = 0.993
    """Discount of a step."""

    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""

    clip_epsilon: float = 0.08
    """The policy's probability ratio is clipped to 1 plus or minus this."""

    entropy_coeff: float = 0.00155
    """Weight of the entropy bonus."""

    critic_coeff: float = 0.5
    """Weight of the value loss, a mean squared error."""

    max_grad_norm: float = 0.64
    """The gradient is scaled down to this norm."""

    normalize_advantage: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1."""

    @property
    def frames_per_batch(self) -> int:
        """Frames that are collected between two updates."""
        return self.num_envs * self.num_steps

    @property
    def num_batches(self) -> int:
        """Batches of the whole training; the last one may exceed ``total_frames``."""
        return math.ceil(self.total_frames / self.frames_per_batch)

    @property
    def frames_per_minibatch(self) -> int:
        """Frames of a minibatch, however it is configured."""
        return self.minibatch_size or self.frames_per_batch // self.num_minibatches

    def check(self) -> None:
        """Raises :class:`ConfigError` for a value of another type or out of range."""
        check_types(self)
        for name in ("total_frames", "num_envs", "num_steps", "num_minibatches", "num_epochs"):
            _check(self, name, getattr(self, name) >= 1, "at least 1")
        for name in ("learning_rate", "clip_epsilon", "critic_coeff", "max_grad_norm"):
            value = getattr(self, name)
            _check(self, name, math.isfinite(value) and value > 0, "a number above 0")
        entropy = self.entropy_coeff
        _check(self, "entropy_coeff", math.isfinite(entropy) and entropy >= 0, "at least 0")
        for name in ("gamma", "gae_lambda"):
            _check(self, name, 0 <= getattr(self, name) <= 1, "in [0, 1]")
        size = self.minibatch_size
        batch = self.frames_per_batch
        if size is not None:
            _check(self, "minibatch_size", 2 <= size <= batch, f"in [2, {batch}], the batch")
        else:
            limit = batch // 2
            _check(self, "num_minibatches", self.num_minibatches <= limit, f"at most {limit}")


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides how a training goes; :func:`preset_config` fills in a preset."""

    scenario: str
    """Scenario to train on, such as academy_3_vs_1_with_keeper."""

    preset: str = "light"
    """Where the defaults come from: light (simple115 and a small network, trains at the engine's
    speed on a CPU) or thesis (mini map, IMPALA network and Table 5.1; wants a GPU)."""

    reward: str = "analytics"
    """What is maximised: analytics (goals, and having the ball where real assists are made),
    potential (the same densities as a potential, which leaves the best policy that of goals),
    checkpoints (gfootball's ten rewards on the way to the goal) or scoring (goals alone)."""

    density: str | None = None
    """For the rewards analytics and potential: file of the assist densities (see fbrl-density fit),
    or uniform, mirrored or shuffled, the controls; by default those that fbrl ships."""

    transition: str = "possession"
    """For the analytics reward: what counts as a received pass, possession (the last controlled
    player with the ball was another one) or consecutive (the controlled player changed in this
    very step)."""

    episode_cap: float | None = None
    """For the analytics reward: what the densities can pay in one match at most, in goals; by
    default there is no limit."""

    observation: str = "simple115"
    """What the agent sees: simple115 (115 numbers), players (274 numbers relative to the controlled
    player), minimap (four stacked mini maps as cell indices) or smm (the same as dense planes)."""

    mask: str | None = None
    """Which actions the agent may not choose: engine (those that the engine ignores in a state) or
    expert (these, and what experts of this environment rule out, such as shots from afar); by
    default it may choose any."""

    network: str = "mlp"
    """What reads players: mlp, a perceptron, or player_set, which treats team-mates and opponents
    as sets. The other observations have one network each."""

    mirror: bool = False
    """Let the network see every state with the ball in the lower half of the pitch, mirrored where
    it is in the upper one."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Layer widths of the network that reads simple115 or players."""

    activation: str = "relu"
    """Activation of that network, relu or tanh."""

    seed: int = 0
    """Seeds the matches, the network and the minibatches."""

    device: str = "auto"
    """Where the network runs: auto (CUDA if there is one), cpu, cuda or cuda:<index>."""

    num_threads: int | None = None
    """Threads that play the matches; by default one for each available core."""

    collector: str = "threads"
    """Where the matches are played: threads of this process, or ray, workers on the nodes of a Ray
    cluster, which wants pip install 'fbrl[ray]'."""

    num_groups: int | None = None
    """Groups of matches that take turns: while the threads step one, the network looks at another.
    By default two, from 48 matches on three."""

    num_workers: int | None = None
    """Ray's workers; by default one for each node. They have to divide num_envs."""

    collect_ahead: bool = False
    """Collect the next batch while learning from one, with the weights of one update before. For a
    GPU that learns while the cores would be idle. Such a training can't be repeated exactly."""

    run_dir: Path | None = None
    """New directory for logs and checkpoints; by default one below runs/ that is named after
    the scenario, the reward, the preset, the seed and the time."""

    logger: tuple[str, ...] = ()
    """Services that metrics are sent to as well: wandb, mlflow; wants pip install 'fbrl[wandb]' or
    'fbrl[mlflow]'. TensorBoard's events and tables are written in any case."""

    checkpoint_interval: int = 100_000
    """Frames between two checkpoints."""

    checkpoint_keep_interval: int = 0
    """Frames between two checkpoints that are kept for good, as checkpoints/<frames>.pt; 0 for
    none."""

    hang_timeout: int = 120
    """Seconds that one step of a match may take before the training is saved and ended, because
    the engine hangs; 0 for any time. A step takes milliseconds."""

    eval_episodes: int = 200
    """Fresh matches played with the trained policy at the end; 0 for none. The presets play 16 of
    the scenarios that last 3000 steps."""

    eval_untrained: bool = False
    """Play as many with the untrained policy first."""

    eval_interval: int = 100_000
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
        check_name("preset", self.preset, PRESET_NAMES)
        check_name("reward", self.reward, REWARD_NAMES)
        check_name("transition", self.transition, TRANSITION_NAMES)
        check_name("observation", self.observation, OBSERVATION_NAMES)
        check_name("activation", self.activation, ACTIVATION_NAMES)
        if self.mask is not None:
            check_name("mask", self.mask, MASK_NAMES)
        check_name("network", self.network, NETWORK_NAMES)
        if self.network == "player_set" and self.observation != "players":
            raise ConfigError(
                f"The network player_set reads players, and the observation is {self.observation}. "
                "Add --observation players."
            )
        _check(self, "hidden_sizes", min(self.hidden_sizes, default=0) >= 1, "positive widths")
        _check(self, "hidden_sizes", len(self.hidden_sizes) <= 64, "at most 64 of them")
        _check(self, "seed", 0 <= self.seed < 2**32, "in [0, 2**32 - 1]")
        check_name("collector", self.collector, COLLECTOR_NAMES)
        for name in self.logger:
            check_name("logger", name, LOGGER_NAMES)
        for name in ("num_threads", "num_groups", "num_workers"):
            value = getattr(self, name)
            _check(self, name, value is None or value >= 1, "at least 1")
        if self.num_workers and self.collector == "threads":
            raise ConfigError("num_workers is only used with the collector ray.")
        if self.collector == "ray" and self.collect_ahead:
            raise ConfigError("collect_ahead is only used with the collector threads.")
        if self.collector == "ray" and self.ppo.num_envs % (self.num_workers or 1):
            raise ConfigError(
                f"num_workers is {self.num_workers}; to share {self.ppo.num_envs} matches "
                "(num_envs) out evenly to ray's workers it must divide them."
            )
        _check(self, "checkpoint_interval", self.checkpoint_interval >= 1, "at least 1")
        for name in ("checkpoint_keep_interval", "hang_timeout", "eval_episodes", "eval_interval"):
            _check(self, name, getattr(self, name) >= 0, "at least 0")
        cap = self.episode_cap
        is_possible = cap is None or (math.isfinite(cap) and cap >= 0)
        _check(self, "episode_cap", is_possible, "a number of at least 0")
        for name, users in _REWARD_OPTIONS.items():
            value, default = getattr(self, name), getattr(type(self), name)
            if self.reward not in users and value != default:
                raise ConfigError(
                    f"{name} ({value!s:.100}) is only used by the {' or the '.join(users)} reward, "
                    f"and the reward is {self.reward}. Leave one of the two out."
                )
        self.ppo.check()


def check_types(config: PPOConfig | TrainConfig) -> None:
    """Raises :class:`ConfigError` for a value of another type than its field's."""
    try:
        check_field_types(config)
    except FieldTypeError as error:
        raise ConfigError(str(error)) from error


def _check(config: Any, name: str, holds: bool, allowed: str) -> None:
    if not holds:
        raise ConfigError(f"{name} is {getattr(config, name)!s:.100}; it must be {allowed}.")
