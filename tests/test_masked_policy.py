"""Policies that heed an action mask: against hand-made cases and TorchRL's distribution."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import MaskedCategorical
from torchrl.objectives import ClipPPOLoss

from fbrl.models import ActorCritic, build_actor_critic
from fbrl.models.collection_policy import PolicyHead

WRITTEN = ("action", "action_log_prob", "state_value")


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def masked_model(**options) -> ActorCritic:
    """With actions of different probabilities, which those of a fresh network hardly have."""
    model = build_actor_critic("simple115", is_masked=True, **options)
    with torch.no_grad():
        model.get_collection_policy().policy_head.weight.mul_(100)
    return model


def masked_batch(size: int) -> TensorDict:
    mask = torch.rand(size, 19) < 0.6
    mask[:, 5] = True
    return TensorDict(simple115=torch.randn(size, 115), action_mask=mask, batch_size=[size])


def distribution(model: ActorCritic, batch: TensorDict) -> torch.distributions.Categorical:
    return model.get_policy_operator().get_dist(batch.clone())


def test_of_equal_actions_those_that_are_left_share_the_probability():
    head = PolicyHead(3, 4)
    with torch.no_grad():
        head.weight.zero_()
        head.bias.copy_(torch.tensor([0.0, 0.0, math.log(2.0), 50.0]))
    mask = torch.tensor([[True, True, True, False], [False, True, False, False]])
    logits = head(torch.randn(2, 3), action_mask=mask)
    dist = torch.distributions.Categorical(logits=logits)
    assert dist.probs.flatten().tolist() == pytest.approx([0.25, 0.25, 0.5, 0, 0, 1, 0, 0])
    entropy = 0.5 * math.log(4) + 0.5 * math.log(2)
    assert dist.entropy().tolist() == pytest.approx([entropy, 0])
    log_probs = dist.log_prob(torch.tensor([2, 1]))
    assert log_probs.tolist() == pytest.approx([math.log(0.5), 0])


def test_the_kullback_leibler_divergence_is_that_of_what_is_left():
    mask = torch.tensor([True, False, True])
    one = torch.tensor([math.log(0.2), 3.0, math.log(0.8)]).masked_fill(~mask, -1e9)
    other = torch.tensor([math.log(0.5), -2.0, math.log(0.5)]).masked_fill(~mask, -1e9)
    heads = []
    for logits in (one, other):
        head = PolicyHead(1, 3)
        with torch.no_grad():
            head.weight.zero_()
            head.bias.copy_(logits)
        heads.append(torch.distributions.Categorical(logits=head(torch.ones(1), None, mask)))
    divergence = torch.distributions.kl_divergence(*heads)
    expected = 0.2 * math.log(0.2 / 0.5) + 0.8 * math.log(0.8 / 0.5)
    assert divergence.item() == pytest.approx(expected)


def test_probabilities_and_entropies_are_those_of_torchrls_masked_distribution():
    model, batch = masked_model(), masked_batch(64)
    everything = batch.clone().set("action_mask", torch.ones(64, 19, dtype=torch.bool))
    logits = distribution(model, everything).logits
    expected = MaskedCategorical(logits=logits, mask=batch["action_mask"])
    dist = distribution(model, batch)
    torch.testing.assert_close(dist.probs, expected.probs)
    torch.testing.assert_close(dist.entropy(), expected.entropy())
    action = expected.sample()
    torch.testing.assert_close(dist.log_prob(action), expected.log_prob(action))
    assert (dist.entropy() > 0.1).any()


def test_a_masked_action_is_never_chosen_and_all_others_are():
    model, batch = masked_model(), masked_batch(1).expand(20_000).contiguous()
    counts = model.get_collection_policy()(batch.clone())["action"].bincount(minlength=19)
    assert (counts[~batch["action_mask"][0]] == 0).all()
    expected = 20_000 * distribution(model, batch[:1]).probs[0]
    likely = expected > 20
    assert likely.sum() > 3
    assert ((counts - expected)[likely].abs() < 5 * expected[likely].sqrt()).all()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = model.get_collection_policy()(batch[:1].clone())["action"]
    assert action.item() == expected.argmax()


@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
def test_the_collection_policy_equals_the_composed_operators_bit_for_bit(exploration, is_mirrored):
    model, batch = masked_model(is_mirrored=is_mirrored), masked_batch(64)
    results = []
    for operator in (model, model.get_collection_policy()):
        torch.manual_seed(3)
        with set_exploration_type(exploration), torch.no_grad():
            results.append(operator(batch.clone()))
    for key in WRITTEN:
        assert torch.equal(results[0][key], results[1][key])


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_ppos_ratio_of_fresh_actions_is_1_and_its_entropy_that_of_what_is_left(is_mirrored):
    model = masked_model(is_mirrored=is_mirrored)
    batch = model.get_collection_policy()(masked_batch(256))
    batch["advantage"], batch["value_target"] = torch.randn(256, 1), torch.randn(256, 1)
    loss = ClipPPOLoss(model.get_policy_operator(), model.get_value_head(), functional=False)
    losses = loss(batch)
    assert losses["kl_approx"].item() == 0
    assert losses["max_ratio"].item() == 1
    expected = distribution(model, batch).entropy().mean()
    torch.testing.assert_close(losses["entropy"], expected)


def test_what_a_masked_action_would_do_has_no_gradient():
    model, batch = masked_model(), masked_batch(1)
    dist = distribution(model, batch)
    action = batch["action_mask"][0].nonzero()[0]
    (dist.log_prob(action) + 0.1 * dist.entropy()).sum().backward()
    gradient = model.get_collection_policy().policy_head.weight.grad
    is_masked = ~batch["action_mask"][0]
    assert (gradient[is_masked] == 0).all()
    assert gradient.isfinite().all()
    assert (gradient[~is_masked] != 0).any(1).all()


def test_a_missing_mask_is_named_with_its_remedy():
    policy = build_actor_critic("simple115", is_masked=True).get_collection_policy()
    with pytest.raises(KeyError, match=r"'action_mask'.*one of fbrl's action masks"):
        policy(TensorDict(simple115=torch.zeros(2, 115), batch_size=[2]))
