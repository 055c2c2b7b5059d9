"""The next batch is collected while the present one is learned from."""

from __future__ import annotations

import dataclasses
import os
import signal

import pytest
import torch

from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.collect import make_collection_env
from fbrl.config import PPOConfig, TrainConfig
from fbrl.models.actor_critic import build_actor_critic
from fbrl.ppo.algorithm import PPO
from fbrl.training.trainer import TrainListener, train

SCENARIO = "academy_3_vs_1_with_keeper"


def test_a_batch_is_collected_with_the_weights_of_one_update_before():
    config = PPOConfig(total_frames=4 * 64, num_envs=2, num_steps=32)
    env, bookkeeping = make_collection_env(SCENARIO, num_envs=2, seed=0)
    model = build_actor_critic("simple115", hidden_sizes=(8,))
    ppo = PPO(env, model, config, bookkeeping, collect_ahead=True)
    begun = []
    shares = []
    for action in range(4):
        # From here on, and until the next batch, nearly always this action.
        bias = model.get_collection_policy().policy_head.bias
        with torch.no_grad():
            bias.fill_(-50)[action] = 50
        batch = ppo.collect(before_next=lambda: begun.append(ppo.frames))
        shares.append([(batch["action"] == other).float().mean().item() for other in range(4)])
        ppo.frames += batch.numel()
    ppo.close()
    env.close()
    assert torch.tensor(shares).argmax(1).tolist() == [0, 0, 1, 2]
    assert torch.tensor(shares).amax(1).min() > 0.9
    assert begun == [0, 64, 128], "nothing is collected that would not be learned from"


def test_such_a_training_ends_and_goes_on_like_any_other(tmp_path):
    config = TrainConfig(
        SCENARIO,
        hidden_sizes=(16,),
        collect_ahead=True,
        eval_episodes=2,
        eval_pictures=False,
        run_dir=tmp_path / "run",
        ppo=PPOConfig(total_frames=512, num_envs=2, num_steps=64, num_minibatches=2, num_epochs=2),
    )

    def stop(frames, _):
        if frames == 256:
            os.kill(os.getpid(), signal.SIGTERM)

    assert train(config, TrainListener(on_metrics=stop)).interrupted
    assert load_checkpoint(config.run_dir)["frames"] == 256
    result = train(config, resume=True)
    assert (result.frames, result.interrupted) == (512, False)
    assert list(read_run_log(config.run_dir).frames) == [128, 256, 384, 512]
    resumed = dataclasses.replace(config, collect_ahead=False)
    assert train(resumed, resume=True).frames == 512


@pytest.mark.slow
@pytest.mark.parametrize(
    ("observation", "option"),
    [("simple115", "compile"), ("simple115", "cuda_graphs"), ("minimap", "compile")],
)
def test_a_compiled_network_has_the_losses_of_the_other(tmp_path, observation, option):
    metrics = {}
    for is_compiled in (False, True):
        config = TrainConfig(
            SCENARIO,
            observation=observation,
            hidden_sizes=(16,),
            eval_episodes=0,
            run_dir=tmp_path / str(is_compiled),
            ppo=PPOConfig(total_frames=32, num_envs=2, num_steps=16, num_epochs=1),
        )
        train(dataclasses.replace(config, **{option: is_compiled}))
        log = read_run_log(config.run_dir)
        metrics[is_compiled] = torch.tensor(
            [log.metric(f"ppo/{name}") for name in ("policy_loss", "value_loss", "gradient_norm")]
        )
    torch.testing.assert_close(metrics[True], metrics[False], rtol=1e-3, atol=1e-5)
