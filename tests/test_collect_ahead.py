"""The next batch is collected while the present one is learned from."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import time

import pytest
import torch
from torchrl.envs import ExplorationType, set_exploration_type

from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.collect import RolloutCollector, make_collection_env
from fbrl.config import PPOConfig, TrainConfig
from fbrl.envs import FootballVectorEnv
from fbrl.models.actor_critic import build_actor_critic
from fbrl.ppo.algorithm import PPO
from fbrl.training import TrainListener, train
from fbrl.training.evaluator import Evaluator

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


def test_actions_are_sampled_while_a_loss_in_another_thread_asks_for_greedy_ones(monkeypatch):
    step = FootballVectorEnv.step
    env, bookkeeping = make_collection_env(SCENARIO, num_envs=2, seed=0)
    policy = build_actor_critic("simple115", hidden_sizes=(8,)).get_collection_policy()
    with contextlib.ExitStack() as loss:

        def step_as_a_loss_begins(matches, actions):
            loss.enter_context(set_exploration_type(ExplorationType.DETERMINISTIC))
            return step(matches, actions)

        monkeypatch.setattr(FootballVectorEnv, "step", step_as_a_loss_begins)
        batch = RolloutCollector(env, policy, 32, bookkeeping).collect()
    env.close()
    # Nearly uniform, as the policy begins; the greedy one is always nearly the same.
    assert len(batch["action"].unique()) > 12


def test_the_policy_that_collects_is_compiled_as_the_model_is(monkeypatch):
    calls = []

    def compile_nothing(function, **options):
        def compiled(*arguments):
            calls.append(options)
            return function(*arguments)

        return compiled

    monkeypatch.setattr(torch, "compile", compile_nothing)
    config = PPOConfig(total_frames=8, num_envs=2, num_steps=4)
    env, bookkeeping = make_collection_env(SCENARIO, num_envs=2, seed=0)
    model = build_actor_critic("simple115", hidden_sizes=(8,))
    model.compile_trunk(cuda_graphs=True)
    ppo = PPO(env, model, config, bookkeeping, collect_ahead=True)
    ppo.collect()
    ppo.close()
    env.close()
    assert calls == [{"mode": "reduce-overhead"}] * 4


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


def test_nothing_is_collected_during_an_evaluation(tmp_path, monkeypatch):
    play, taken = Evaluator.play, []

    def play_later(evaluator, *arguments):
        before = torch.get_rng_state()
        time.sleep(0.2)
        taken.append(not torch.equal(torch.get_rng_state(), before))
        return play(evaluator, *arguments)

    monkeypatch.setattr(Evaluator, "play", play_later)
    config = TrainConfig(
        SCENARIO,
        hidden_sizes=(16,),
        collect_ahead=True,
        eval_episodes=1,
        eval_interval=512,
        eval_pictures=False,
        run_dir=tmp_path / "run",
        ppo=PPOConfig(total_frames=1024, num_envs=2, num_steps=256, num_epochs=1),
    )
    train(config)
    assert taken == [False, False]


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
