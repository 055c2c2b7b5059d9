"""Proximal policy optimisation of a policy with discrete actions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import reward2go

from fbrl.config import PPOConfig
from fbrl.ppo.advantages import add_advantages, explained_variance
from fbrl.ppo.update import minibatches, update

if TYPE_CHECKING:
    from fbrl.collect.collector import BatchCollector
    from fbrl.models.actor_critic import ActorCritic

_CRITIC_LOSSES = {"l2": "l2", "huber": "smooth_l1"}
"""TorchRL's names of them."""

_REWARD_SCALE_DECAY = 0.99
"""Of a batch's weight in the scale of the rewards, with each later batch."""


class PPO:
    """Collects batches and learns from them; training is ``collect`` and ``learn`` in turn.

    Args:
        collector: Plays with the model's policy.
        model: Actor-critic whose trunk reads what is observed. It is trained in place, on the
            device where it is.
        config: Hyperparameters; the collector was made with its ``num_envs``, ``num_steps`` and
            ``frame_skip``.

    Attributes:
        frames: Frames learned from so far.
        device: Where the model is.

    Examples:
        >>> from fbrl.collect import RolloutCollector
        >>> from fbrl.envs import make_env
        >>> from fbrl.models.actor_critic import build_actor_critic
        >>> config = PPOConfig(total_frames=64, num_envs=2, num_steps=16, num_minibatches=2)
        >>> env = make_env("academy_empty_goal", num_envs=2, seed=0)
        >>> model = build_actor_critic("simple115")
        >>> collector = RolloutCollector(env, model.get_collection_policy(), config.num_steps)
        >>> ppo = PPO(collector, model, config)
        >>> while ppo.frames < config.total_frames:
        ...     losses = ppo.learn(ppo.collect())
        >>> ppo.frames
        64
    """

    def __init__(self, collector: BatchCollector, model: ActorCritic, config: PPOConfig) -> None:
        self.collector = collector
        self.model = model
        self.config = config
        self.device = next(model.parameters()).device
        self.frames = 0
        # The value head alone: it reads what the actor's trunk has left, so the trunk runs once.
        self.loss = ClipPPOLoss(
            model.get_policy_operator(),
            model.get_value_head(),
            clip_epsilon=config.clip_epsilon,
            entropy_coeff=config.entropy_coeff,
            critic_coeff=config.critic_coeff,
            loss_critic_type=_CRITIC_LOSSES[config.value_loss],
            normalize_advantage=config.normalize_advantage,
            # Nothing here needs the parameters apart from their modules, which costs time.
            functional=False,
        )
        # eps as in OpenAI's Baselines, on which the thesis and gfootball's own training ran.
        self.optimizer = torch.optim.Adam(
            model.parameters(), config.learning_rate, eps=1e-5, fused=True
        )
        self._reward_scale = RewardScale(config.gamma)
        learned = ("action", "action_log_prob", "advantage", "value_target", "state_value")
        self._learned_keys = [*model.in_keys, *learned]

    def collect(self) -> TensorDictBase:
        """Plays ``num_steps`` steps in each match; see :meth:`BatchCollector.collect`."""
        return self.collector.collect()

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Updates the model with a batch.

        Returns:
            Means over the updates of what :func:`fbrl.ppo.update.update` returns, with
            ``explained_variance`` and ``learning_rate``.
        """
        config = self.config
        learning_rate = self._set_schedules()
        add_advantages(
            batch,
            self.model.get_value_operator(),
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            reward_scale=self._reward_scale.update(batch) if config.normalize_reward else 1.0,
        )
        # All at once, and no observation of a following step, so that a GPU waits once.
        flat = batch.select(*self._learned_keys).reshape(-1).to(self.device)
        steps: list[TensorDictBase] = []
        for _ in range(config.num_epochs):
            epoch = [
                update(self.loss, self.optimizer, minibatch, config.max_grad_norm)
                for minibatch in minibatches(flat, config.steps_per_minibatch)
            ]
            steps += epoch
            # Reading it makes a GPU wait.
            kl = 0.0 if config.target_kl is None else TensorDict.stack(epoch)["approx_kl"].mean()
            if kl > (config.target_kl or 0.0):
                break
        self.frames += batch.numel() * config.frame_skip
        means = TensorDict.stack(steps).mean(0)
        means["explained_variance"] = explained_variance(flat)
        losses = {name: float(value) for name, value in means.cpu().items()}
        return {**losses, "learning_rate": learning_rate}

    def state_dict(self) -> dict[str, Any]:
        """What has been learned; not what the collector goes on from, nor the random numbers."""
        return {
            "frames": self.frames,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "reward_scale": self._reward_scale.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from what :meth:`state_dict` returned."""
        self.frames = state["frames"]
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        # Checkpoints from before there was a scale have none.
        if "reward_scale" in state:
            self._reward_scale.load_state_dict(state["reward_scale"])

    def _set_schedules(self) -> float:
        """The rate and the entropy's weight go linearly with the frames before this batch."""
        config, left = self.config, max(0.0, 1 - self.frames / self.config.total_frames)
        learning_rate = config.learning_rate * (left if config.anneal_learning_rate else 1)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        if config.entropy_coeff_end is not None:
            end = config.entropy_coeff_end
            self.loss.entropy_coeff.fill_(end + (config.entropy_coeff - end) * left)
        return learning_rate


class RewardScale:
    """The root mean square of discounted returns, averaged over the latest hundred batches or so.

    Divided by it, rewards of any size lead to returns of about 1, for which the learning rate, the
    norm of gradients and the weight of the critic's loss are made. It is what Stable-Baselines3's
    ``VecNormalize`` and OpenAI's Baselines do; rewards are not shifted, which would change what is
    best where episodes have different lengths.
    """

    def __init__(self, gamma: float) -> None:
        self._gamma = gamma
        self._square = self._weight = 0.0

    def update(self, batch: TensorDictBase) -> float:
        """Takes in a batch (num_envs, num_steps), and returns what to divide its rewards by.

        What is paid after the batch's end is not counted.
        """
        following = batch.get("next")
        returns = reward2go(following.get("reward"), following.get("done"), self._gamma)
        square = float(returns.double().square().mean())
        decay = _REWARD_SCALE_DECAY
        self._square = decay * self._square + (1 - decay) * square
        self._weight = decay * self._weight + 1 - decay
        return math.sqrt(self._square / self._weight) or 1.0

    def state_dict(self) -> dict[str, float]:
        """What later scales depend on."""
        return {"square": self._square, "weight": self._weight}

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Goes on from what :meth:`state_dict` returned."""
        self._square, self._weight = float(state["square"]), float(state["weight"])
