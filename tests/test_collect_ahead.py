"""The next batch is collected while the present one is learned from."""

from __future__ import annotations

import dataclasses
import os
import signal
import time

import torch
from torchrl.envs import ExplorationType, set_exploration_type

from fbrl.analysis.run_log import read_run_log
from fbrl.checkpoint import load_checkpoint
from fbrl.collect import AheadCollector, MatchCollector
from fbrl.config import PPOConfig, TrainConfig
from fbrl.models.actor_critic import build_actor_critic
from fbrl.training import TrainListener, train
from fbrl.training.evaluator import Evaluator

SCENARIO = "academy_3_vs_1_with_keeper"


def test_a_batch_is_collected_with_the_weights_of_one_update_before():
    policy = build_actor_critic("simple115", hidden_sizes=(8,)).get_collection_policy()
    collector = AheadCollector(
        lambda own: MatchCollector(SCENARIO, own, num_envs=2, num_steps=32, seed=0), policy
    )
    shares = []
    for action in range(4):
        # From here on, and until the next batch, nearly always this action.
        with torch.no_grad():
            policy.policy_head.bias.fill_(-50)[action] = 50
        batch = collector.collect()
        if action < 3:
            collector.begin_next()
        shares.append([(batch["action"] == other).float().mean().item() for other in range(4)])
    collector.close()
    assert torch.tensor(shares).argmax(1).tolist() == [0, 0, 1, 2]
    assert torch.tensor(shares).amax(1).min() > 0.9


def test_nothing_is_collected_that_would_not_be_learned_from(tmp_path, monkeypatch):
    begun, begin_next = [], AheadCollector.begin_next

    def count(self):
        if self._in_flight is None:
            begun.append(self)
        begin_next(self)

    monkeypatch.setattr(AheadCollector, "begin_next", count)
    config = TrainConfig(
        SCENARIO,
        network_options={"hidden_sizes": (8,)},
        collect_ahead=True,
        eval_episodes=0,
        run_dir=tmp_path / "run",
        ppo=PPOConfig(total_frames=4 * 64, num_envs=2, num_steps=32),
    )
    train(config)
    assert len(begun) == 4


def test_actions_are_sampled_while_a_loss_in_another_thread_asks_for_greedy_ones():
    policy = build_actor_critic("simple115", hidden_sizes=(8,)).get_collection_policy()
    collector = MatchCollector(SCENARIO, policy, num_envs=2, num_steps=32, seed=0)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        batch = collector.collect()
    collector.close()
    # Nearly uniform, as the policy begins; the greedy one is always nearly the same.
    assert len(batch["action"].unique()) > 12


def test_such_a_training_ends_and_goes_on_like_any_other(tmp_path):
    config = TrainConfig(
        SCENARIO,
        network_options={"hidden_sizes": (16,)},
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
        network_options={"hidden_sizes": (16,)},
        collect_ahead=True,
        eval_episodes=1,
        eval_interval=512,
        eval_pictures=False,
        run_dir=tmp_path / "run",
        ppo=PPOConfig(total_frames=1024, num_envs=2, num_steps=256, num_epochs=1),
    )
    train(config)
    assert taken == [False, False]
