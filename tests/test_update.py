"""The clipped objective and the gradient step on cases worked out by hand."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from fbrl.config import PPOConfig
from fbrl.models.actor_critic import ActorCritic
from fbrl.models.mlp import MLP
from fbrl.ppo.algorithm import PPO
from fbrl.ppo.update import TrainingDivergedError, minibatches, update


def make_ppo(**changes):
    torch.manual_seed(0)
    model = ActorCritic(MLP((3,), (8,), "tanh"), "observation", 8, 4)
    with torch.no_grad():
        model.get_collection_policy().policy_head.weight.mul_(100)
    return PPO(None, model, PPOConfig(**changes))


def make_minibatch(ppo, frames=16, seed=1):
    generator = torch.Generator().manual_seed(seed)
    batch = TensorDict(
        {
            "observation": torch.randn(frames, 3, generator=generator),
            "advantage": torch.randn(frames, 1, generator=generator),
            "value_target": torch.randn(frames, 1, generator=generator),
        },
        batch_size=[frames],
    )
    ppo.model.get_collection_policy()(batch)
    return batch


def reference_losses(ppo, minibatch):
    """PPO's objective in numpy: Schulman et al. 2017, equation 9, with SB3's value loss."""
    config = ppo.config
    with torch.no_grad():
        after = ppo.model(minibatch.select("observation"))
        log_probs = after["logits"].log_softmax(-1).double().numpy()
        value = after["state_value"].squeeze(-1).double().numpy()
    action = minibatch["action"].numpy()
    advantage = minibatch["advantage"].squeeze(-1).double().numpy()
    if config.normalize_advantage:
        advantage = (advantage - advantage.mean()) / advantage.std(ddof=1)
    log_ratio = log_probs[np.arange(len(action)), action] - minibatch["action_log_prob"].numpy()
    ratio = np.exp(log_ratio)
    clipped = np.clip(ratio, 1 - config.clip_epsilon, 1 + config.clip_epsilon)
    entropy = -(np.exp(log_probs) * log_probs).sum(-1).mean()
    target = minibatch["value_target"].squeeze(-1).double().numpy()
    return {
        "policy_loss": -np.minimum(ratio * advantage, clipped * advantage).mean(),
        "value_loss": config.critic_coeff * ((value - target) ** 2).mean(),
        "entropy": entropy,
        "clip_fraction": (np.abs(ratio - 1) > config.clip_epsilon).mean(),
    }


@pytest.mark.parametrize("normalize_advantage", [False, True])
def test_losses_equal_the_papers_objective(normalize_advantage):
    ppo = make_ppo(normalize_advantage=normalize_advantage, clip_epsilon=0.1)
    minibatch = make_minibatch(ppo)
    # As if the policy had moved since the actions were chosen, up to and past the clip range.
    minibatch["action_log_prob"] += torch.linspace(-0.3, 0.3, 16)
    expected = reference_losses(ppo, minibatch)
    assert 0 < expected["clip_fraction"] < 1
    losses = update(ppo.loss, ppo.optimizer, minibatch, 1.0)
    for name, value in expected.items():
        assert losses[name].item() == pytest.approx(value, rel=1e-4, abs=1e-6), name


def test_the_first_update_of_a_batch_starts_from_the_collecting_policy():
    ppo = make_ppo()
    losses = update(ppo.loss, ppo.optimizer, make_minibatch(ppo), 1.0)
    assert losses["approx_kl"].item() == pytest.approx(0, abs=1e-6)
    assert losses["clip_fraction"].item() == 0


def test_updates_make_good_actions_likelier_and_pull_values_to_their_targets():
    ppo = make_ppo(learning_rate=1e-2, clip_epsilon=0.5, normalize_advantage=False)
    minibatch = make_minibatch(ppo, frames=64)
    before = reference_losses(ppo, minibatch)
    for _ in range(40):
        update(ppo.loss, ppo.optimizer, minibatch, 10.0)
    after = reference_losses(ppo, minibatch)
    assert after["policy_loss"] < before["policy_loss"] - 0.1
    assert after["value_loss"] < 0.7 * before["value_loss"]


def test_a_ratio_past_the_clip_range_gets_no_policy_gradient():
    ppo = make_ppo(normalize_advantage=False, entropy_coeff=0.0)
    minibatch = make_minibatch(ppo)
    minibatch["value_target"] = minibatch["state_value"].clone()
    minibatch["advantage"] = torch.ones(16, 1)
    minibatch["action_log_prob"] -= 1.0
    losses = update(ppo.loss, ppo.optimizer, minibatch, 1.0)
    assert losses["clip_fraction"].item() == 1
    assert losses["gradient_norm"].item() == 0


def test_gradients_are_scaled_down_to_the_given_norm():
    ppo = make_ppo()
    minibatch = make_minibatch(ppo)
    minibatch["value_target"] *= 100
    losses = update(ppo.loss, ppo.optimizer, minibatch, 0.5)
    assert losses["gradient_norm"].item() > 10
    norms = [p.grad.norm() for p in ppo.model.parameters()]
    assert torch.stack(norms).norm().item() == pytest.approx(0.5, rel=1e-3)


def test_every_parameter_of_the_model_is_trained_once():
    ppo = make_ppo()
    held = [p for group in ppo.optimizer.param_groups for p in group["params"]]
    assert {id(p) for p in held} == {id(p) for p in ppo.model.parameters()}
    assert len(held) == len({id(p) for p in held})
    before = [p.clone() for p in ppo.model.parameters()]
    update(ppo.loss, ppo.optimizer, make_minibatch(ppo), 1.0)
    for old, new in zip(before, ppo.model.parameters(), strict=True):
        assert not torch.equal(old, new)


def test_minibatches_take_each_frame_once_and_leave_a_remainder_out():
    batch = TensorDict({"frame": torch.arange(103)}, batch_size=[103])
    torch.manual_seed(0)
    parts = [part["frame"] for part in minibatches(batch, 20)]
    assert [len(part) for part in parts] == [20] * 5
    frames = torch.cat(parts).tolist()
    assert len(set(frames)) == 100
    assert frames != sorted(frames)
    again = [part["frame"] for part in minibatches(batch, 20)]
    assert torch.cat(again).tolist() != frames


def test_the_learning_rate_falls_linearly_to_zero():
    ppo = make_ppo(total_frames=1000, learning_rate=0.1)
    rates = []
    for ppo.frames in (0, 250, 1000, 1200):
        rates.append(ppo._set_schedules())
        assert ppo.optimizer.param_groups[0]["lr"] == rates[-1]
    assert rates == pytest.approx([0.1, 0.075, 0.0, 0.0])
    constant = make_ppo(total_frames=1000, learning_rate=0.1, anneal_learning_rate=False)
    constant.frames = 900
    assert constant._set_schedules() == 0.1


def test_a_uniform_policys_entropy_is_the_logarithm_of_the_number_of_actions():
    ppo = make_ppo()
    with torch.no_grad():
        ppo.model.get_collection_policy().policy_head.weight.zero_()
    losses = update(ppo.loss, ppo.optimizer, make_minibatch(ppo), 1.0)
    assert losses["entropy"].item() == pytest.approx(math.log(4))


@pytest.mark.parametrize("broken", ["value_target", "advantage", "weights"])
def test_a_step_that_is_not_finite_is_not_taken(broken):
    ppo = make_ppo(normalize_advantage=False)
    minibatch = make_minibatch(ppo)
    if broken == "weights":
        with torch.no_grad():
            ppo.model.get_collection_policy().policy_head.weight.fill_(float("inf"))
    else:
        minibatch[broken][3] = float("nan")
    before = [p.clone() for p in ppo.model.parameters()]
    with pytest.raises(TrainingDivergedError, match="lower learning_rate"):
        update(ppo.loss, ppo.optimizer, minibatch, 1.0)
    for old, new in zip(before, ppo.model.parameters(), strict=True):
        assert torch.equal(old, new)


def make_batch(ppo, num_envs=2, num_steps=8):
    """A batch as a collector hands it over, of an environment that pays at random."""
    torch.manual_seed(2)
    shape = (num_envs, num_steps)
    batch = TensorDict(observation=torch.randn(*shape, 3), batch_size=shape)
    ppo.model.get_collection_policy()(batch)
    ended = torch.zeros(*shape, 1, dtype=torch.bool)
    batch["next"] = TensorDict(
        observation=torch.randn(*shape, 3),
        reward=torch.randn(*shape, 1),
        done=ended,
        terminated=ended.clone(),
        batch_size=shape,
    )
    return batch


def updates_of(ppo, monkeypatch):
    """How many gradient steps it takes for a batch."""
    taken = []
    monkeypatch.setattr(
        "fbrl.ppo.algorithm.update", lambda *args: taken.append(None) or update(*args)
    )
    ppo.learn(make_batch(ppo))
    return len(taken)


SMALL = {"num_envs": 2, "num_steps": 8, "num_minibatches": 4, "learning_rate": 0.03}


def test_epochs_end_when_the_policy_has_gone_too_far(monkeypatch):
    assert updates_of(make_ppo(num_epochs=5, **SMALL), monkeypatch) == 20
    assert updates_of(make_ppo(num_epochs=5, target_kl=1e-6, **SMALL), monkeypatch) == 4
    assert updates_of(make_ppo(num_epochs=5, target_kl=1e6, **SMALL), monkeypatch) == 20


def test_the_weight_of_the_entropy_goes_linearly_to_its_end():
    ppo = make_ppo(entropy_coeff=0.4, entropy_coeff_end=0.2, total_frames=32, **SMALL)
    weights = []
    while ppo.frames < 32:
        ppo.learn(make_batch(ppo))
        weights.append(ppo.loss.entropy_coeff.item())
    assert weights == pytest.approx([0.4, 0.3])


def test_the_weight_of_the_entropy_stays_by_default():
    ppo = make_ppo(entropy_coeff=0.4, total_frames=16, **SMALL)
    ppo.learn(make_batch(ppo))
    assert ppo.loss.entropy_coeff.item() == pytest.approx(0.4)


def test_large_errors_of_the_critic_count_linearly_with_huber():
    ppo = make_ppo(value_loss="huber")
    minibatch = make_minibatch(ppo)
    minibatch["value_target"] *= 10
    with torch.no_grad():
        value = ppo.model(minibatch.select("observation"))["state_value"]
    error = (value - minibatch["value_target"]).abs().double().numpy()
    expected = ppo.config.critic_coeff * np.where(error < 1, error**2 / 2, error - 0.5).mean()
    losses = update(ppo.loss, ppo.optimizer, minibatch, 1.0)
    assert losses["value_loss"].item() == pytest.approx(expected, rel=1e-5)


def test_importing_ppo_imports_nothing_of_football():
    program = "import sys, fbrl.ppo; print(*[name for name in sys.modules if 'fbrl' in name])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    loaded = {name.split(".")[1] for name in done.stdout.split() if "." in name}
    assert "ppo" in loaded
    assert loaded & {"envs", "transforms", "density", "models", "collect", "drawing"} == set()
