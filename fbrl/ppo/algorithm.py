"""Proximal policy optimisation on any TorchRL environment with discrete actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase
from torchrl.objectives import ClipPPOLoss

from fbrl.collect.ahead_collector import AheadCollector
from fbrl.collect.collector import (
    BatchCollector,
    RolloutCollector,
    inference_threads,
    torch_threads,
)
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.config import PPOConfig
from fbrl.models.actor_critic import ActorCritic
from fbrl.ppo.advantages import add_advantages, explained_variance
from fbrl.ppo.update import minibatches, update


class PPO:
    """Collects batches and learns from them; training is ``collect`` and ``learn`` in turn.

    Args:
        env: Vectorised environment with batch size (num_envs,), or what collects in its place.
        model: Actor-critic whose trunk reads the environment's observation. It is trained in
            place, on the device where it is.
        config: Hyperparameters.
        bookkeeping: The other part of :func:`fbrl.collect.make_collection_env`'s environment.
        collect_ahead: Collect the next batch while learning from one, see
            :class:`fbrl.collect.collector.AheadCollector`.

    Attributes:
        frames: Frames learned from so far.
        device: Where the model is.

    Examples:
        >>> from fbrl.envs import make_env
        >>> from fbrl.models.actor_critic import build_actor_critic
        >>> config = PPOConfig(total_frames=64, num_envs=2, num_steps=16, num_minibatches=2)
        >>> env = make_env("academy_empty_goal", num_envs=2, seed=0)
        >>> ppo = PPO(env, build_actor_critic("simple115"), config)
        >>> while ppo.frames < config.total_frames:
        ...     losses = ppo.learn(ppo.collect())
        >>> ppo.frames
        64
    """

    def __init__(
        self,
        env: EnvBase | BatchCollector,
        model: ActorCritic,
        config: PPOConfig,
        bookkeeping: EpisodeBookkeeping | None = None,
        *,
        collect_ahead: bool = False,
    ) -> None:
        self.model = model
        self.config = config
        self.device = next(model.parameters()).device
        self.frames = 0
        policy = model.get_collection_policy()
        self._inference_threads = inference_threads(policy)
        self._collector: BatchCollector | AheadCollector
        if isinstance(env, BatchCollector):
            self._collector = env
        elif collect_ahead:
            own = RolloutCollector(
                env, model.copy_collection_policy(), config.num_steps, bookkeeping
            )
            self._collector = AheadCollector(own, policy)
        else:
            self._collector = RolloutCollector(env, policy, config.num_steps, bookkeeping)
        # The value head alone: it reads what the actor's trunk has left, so the trunk runs once.
        self.loss = ClipPPOLoss(
            model.get_policy_operator(),
            model.get_value_head(),
            clip_epsilon=config.clip_epsilon,
            entropy_coeff=config.entropy_coeff,
            critic_coeff=config.critic_coeff,
            loss_critic_type="l2",
            normalize_advantage=config.normalize_advantage,
            # Nothing here needs the parameters apart from their modules, which costs time.
            functional=False,
        )
        # eps as in OpenAI's Baselines, on which the thesis and gfootball's own training ran.
        self.optimizer = torch.optim.Adam(
            model.parameters(), config.learning_rate, eps=1e-5, fused=True
        )
        self._learned_keys = [
            *model.get_value_operator().in_keys,
            "action",
            "action_log_prob",
            "advantage",
            "value_target",
            "state_value",
        ]

    def start(self) -> None:
        """Resets the environment, unless a batch has been collected or a state loaded already.

        The first batch does so by itself.
        """
        if self._collector.state is None:
            self.restart()

    def restart(self) -> None:
        """Resets the environment, whatever the next batch would have begun with."""
        self._collector.reset()

    def collect(self, before_next: Callable[[], None] = lambda: None) -> TensorDictBase:
        """Plays ``num_steps`` steps in each match.

        The first call resets the environment, so it may be seeded, or used, until then.

        Args:
            before_next: Called before the next batch begins, where one is collected ahead.

        Returns:
            A batch of shape (num_envs, num_steps) on the CPU, valid until the next call.
        """
        self.start()
        if isinstance(self._collector, AheadCollector):
            frames = self.frames + self.config.frames_per_batch
            is_last = frames >= self.config.total_frames
            return self._collector.collect(is_last=is_last, before_next=before_next)
        with torch_threads(self._inference_threads):
            return self._collector.collect()

    def wait(self) -> None:
        """Waits until no match is being played; :meth:`collect` goes on from there."""
        if isinstance(self._collector, AheadCollector):
            self._collector.wait()

    def close(self) -> None:
        """Waits for a batch that is collected ahead; only then may the environment be closed."""
        if isinstance(self._collector, AheadCollector):
            self._collector.close()

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Updates the model with a batch.

        Returns:
            Means over the updates of what :func:`fbrl.ppo.update.update` returns, with
            ``explained_variance`` and ``learning_rate``.
        """
        config = self.config
        learning_rate = self._set_learning_rate()
        add_advantages(
            batch,
            self.model.get_value_operator(),
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
        )
        # All at once, and no observation of a following step, so that a GPU waits once.
        flat = batch.select(*self._learned_keys).reshape(-1).to(self.device)
        steps = [
            update(self.loss, self.optimizer, minibatch, config.max_grad_norm)
            for _ in range(config.num_epochs)
            for minibatch in minibatches(flat, config.frames_per_minibatch)
        ]
        self.frames += batch.numel()
        means = TensorDict.stack(steps).mean(0)
        means["explained_variance"] = explained_variance(flat)
        losses = {name: float(value) for name, value in means.cpu().items()}
        return {**losses, "learning_rate": learning_rate}

    @property
    def next_step(self) -> dict[str, Any]:
        """What the next batch begins with, as a checkpoint takes it.

        It belongs to the environment's state at the same moment, which is not in it.

        Raises:
            RuntimeError: There is no next batch yet: call :meth:`start`.
        """
        if self._collector.state is None:
            raise RuntimeError("The matches have not begun: call start() before next_step.")
        return self._collector.state.to_dict()

    def state_dict(self) -> dict[str, Any]:
        """What has been learned, as a checkpoint takes it.

        The environment, the next step and the random numbers are not in it.
        """
        return {
            "frames": self.frames,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state; the environment has to be put back to that of the next step.

        Args:
            state: What :meth:`state_dict` returned, with :attr:`next_step` under its name.
        """
        self.frames = state["frames"]
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self._collector.state = TensorDict(
            state["next_step"], batch_size=[self.config.num_envs], device="cpu"
        )

    def _set_learning_rate(self) -> float:
        """The rate falls linearly with the frames learned from before this batch."""
        learning_rate = self.config.learning_rate
        if self.config.anneal_learning_rate:
            learning_rate *= max(0.0, 1 - self.frames / self.config.total_frames)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        return learning_rate
