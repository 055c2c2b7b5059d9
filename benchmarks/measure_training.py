"""Whole trainings against Stable-Baselines3's PPO on gfootball's own environment.

Both sides collect and learn with the same network, hyperparameters, number of matches and size of
minibatches. Start-up and the first iteration are left out on both sides.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fbrl.config import TrainConfig


def training_config(
    scenario: str, network: str, num_steps: int, iterations: int, device: str, seed: int
) -> TrainConfig:
    """The preset thesis for ``"cnn"``, light for ``"mlp"``, with batches one can wait for.

    The minibatches keep the preset's size, as far as a batch of ``num_steps`` has so many frames.
    """
    from fbrl.presets import preset_config

    config = preset_config("thesis" if network == "cnn" else "light", scenario)
    batch = config.ppo.num_envs * num_steps
    ppo = dataclasses.replace(
        config.ppo,
        num_steps=num_steps,
        minibatch_size=min(batch, config.ppo.steps_per_minibatch),
        total_frames=batch * iterations,
    )
    return dataclasses.replace(config, ppo=ppo, device=device, seed=seed, eval_episodes=0)


def fbrl_training(
    scenario: str,
    network: str,
    num_steps: int,
    iterations: int,
    device: str,
    seed: int,
    precision: str | None = None,
) -> dict[str, float]:
    """Trains as ``fbrl-train`` does, with the analytics reward, logging and all."""
    from fbrl.training import TrainListener, train

    config = training_config(scenario, network, num_steps, iterations, device, seed)
    if precision is not None:
        config = dataclasses.replace(config, network_options={"precision": precision})
    ends: list[float] = []
    listener = TrainListener(on_metrics=lambda *_: ends.append(time.perf_counter()))
    with tempfile.TemporaryDirectory(prefix="fbrl-benchmark-") as directory:
        train(dataclasses.replace(config, run_dir=Path(directory) / "run"), listener)
    return _frames_per_second(config, ends)


def stable_baselines3_training(
    scenario: str, network: str, num_steps: int, iterations: int, device: str, seed: int
) -> dict[str, float]:
    """Trains with Stable-Baselines3 in processes, as its documentation recommends."""
    import stable_baselines3
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from benchmarks.gfootball_env import GFootballEnv
    from benchmarks.stable_baselines3_network import ImpalaFeatures, MLPFeatures

    config = training_config(scenario, network, num_steps, iterations, device, seed)
    ppo = config.ppo
    is_cnn = network == "cnn"
    arguments = {
        "scenario": scenario,
        "representation": "extracted" if is_cnn else "simple115v2",
        "stacked": is_cnn,
    }
    env = make_vec_env(
        GFootballEnv, ppo.num_envs, seed=seed, env_kwargs=arguments, vec_env_cls=SubprocVecEnv
    )
    algorithm = stable_baselines3.PPO(
        "CnnPolicy" if is_cnn else "MlpPolicy",
        env,
        n_steps=ppo.num_steps,
        batch_size=ppo.steps_per_minibatch,
        n_epochs=ppo.num_epochs,
        learning_rate=lambda left: ppo.learning_rate * left,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip_epsilon,
        normalize_advantage=ppo.normalize_advantage,
        ent_coef=ppo.entropy_coeff,
        vf_coef=ppo.critic_coeff,
        max_grad_norm=ppo.max_grad_norm,
        policy_kwargs={
            "features_extractor_class": ImpalaFeatures if is_cnn else MLPFeatures,
            # The heads follow the features directly, as ours do.
            "net_arch": [],
            # The network has its own initialisation.
            "ortho_init": False,
        },
        seed=seed,
        device=device,
    )
    starts: list[float] = []

    class Clock(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            starts.append(time.perf_counter())

    algorithm.learn(ppo.total_frames, callback=Clock())
    ends = [*starts[1:], time.perf_counter()]
    env.close()
    return _frames_per_second(config, ends)


def _frames_per_second(config: TrainConfig, ends: list[float]) -> dict[str, float]:
    """From the times at which the iterations ended, the first one left out."""
    frames: Any = config.ppo.frames_per_batch * (len(ends) - 1)
    return {"frames_per_second": frames / (ends[-1] - ends[0])}
