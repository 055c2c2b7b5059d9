"""PPO on the observation players, with masks, the mirror and either network."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import Compose

import fbrl.cli.eval
import fbrl.cli.train
from fbrl.agent import load_agent
from fbrl.collect import MatchCollector
from fbrl.config import PPOConfig, TrainConfig
from fbrl.models import PlayerSet, build_actor_critic
from fbrl.ppo import PPO
from fbrl.ppo.update import minibatches, update
from fbrl.training import train
from fbrl.transforms import ActionMemory, EngineActionMask, ExpertActionMask, Players

CONFIG = PPOConfig(total_frames=256, num_envs=4, num_steps=32, num_minibatches=2, num_epochs=2)


def make_collector(scenario, model, observation):
    return MatchCollector(
        scenario,
        model.get_collection_policy(),
        num_envs=4,
        num_steps=32,
        observation=Compose(*observation),
        num_groups=2,
        seed=0,
    )


@pytest.mark.parametrize("mask", [None, EngineActionMask, ExpertActionMask])
@pytest.mark.parametrize("network", ["mlp", "player_set"])
def test_a_batch_is_collected_and_learned_from(network, mask):
    torch.manual_seed(0)
    observation = [ActionMemory(), Players()] + ([mask()] if mask else [])
    model = build_actor_critic(
        "players", network=network, is_mirrored=True, is_masked=mask is not None
    )
    before = [parameter.detach().clone() for parameter in model.parameters()]
    collector = make_collector("academy_3_vs_1_with_keeper", model, observation)
    ppo = PPO(collector, model, CONFIG)
    losses = []
    for _ in range(2):
        batch = ppo.collect()
        if mask:
            chosen = batch["action_mask"].gather(-1, batch["action"].unsqueeze(-1))
            assert chosen.all()
            assert not batch["action_mask"].all()
        assert batch["players"][..., :10].any()
        losses.append(ppo.learn(batch))
    collector.close()
    assert all(0 < loss["entropy"] < 3 for loss in losses)
    after = model.parameters()
    assert all(not torch.equal(one, other) for one, other in zip(before, after, strict=True))


def test_the_first_update_on_fresh_actions_has_no_divergence():
    torch.manual_seed(0)
    model = build_actor_critic("players", is_mirrored=True, is_masked=True)
    with torch.no_grad():
        model.get_collection_policy().policy_head.weight.mul_(100)
    observation = [ActionMemory(), Players(), EngineActionMask()]
    collector = make_collector("academy_counterattack_hard", model, observation)
    ppo = PPO(collector, model, CONFIG)
    batch = ppo.collect()
    collector.close()
    batch["advantage"] = batch["value_target"] = torch.randn(*batch.shape, 1)
    minibatch = next(minibatches(batch.reshape(-1), 64))
    first = update(ppo.loss, ppo.optimizer, minibatch, 0.5)
    assert abs(first["approx_kl"].item()) < 1e-6
    assert first["clip_fraction"].item() == 0


def test_the_command_trains_and_evaluates_such_an_agent(run_main, tmp_path):
    run_dir = tmp_path / "run"
    sizes = ["--num-envs", 2, "--num-steps", 64, "--total-frames", 128, "--eval-episodes", 0]
    agent = ["--observation", "players", "--network", "player_set", "--mirror"]
    agent += ["--mask", "expert"]
    arguments = ["academy_empty_goal_close", *agent, *sizes, "--run-dir", run_dir]
    run_main(fbrl.cli.train.main, *arguments)
    loaded = load_agent(run_dir)
    assert (loaded.config.mirror, loaded.config.mask) == (True, "expert")
    assert isinstance(loaded.model.get_collection_policy().trunk.trunk, PlayerSet)
    assert "action_mask" in loaded.model.get_collection_policy().in_keys
    printed = run_main(fbrl.cli.eval.main, run_dir, "--episodes", 4)
    assert "goal difference" in printed.out


def test_no_masked_action_is_chosen_in_a_training(tmp_path):
    config = TrainConfig(
        "academy_3_vs_1_with_keeper",
        mask="engine",
        network_options={"hidden_sizes": (16,)},
        eval_episodes=0,
        run_dir=tmp_path / "run",
        ppo=CONFIG,
    )
    batches = []
    learn = PPO.learn

    def learn_and_look(ppo, batch):
        batches.append(batch.clone())
        return learn(ppo, batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PPO, "learn", learn_and_look)
        train(config)
    for batch in batches:
        assert (~batch["action_mask"]).sum(-1).unique().tolist() == [3]
        assert batch["action_mask"].gather(-1, batch["action"].unsqueeze(-1)).all()
