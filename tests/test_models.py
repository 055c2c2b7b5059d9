"""The networks against gfootball's definition, and the actor-critic under TorchRL's PPO loss."""

from __future__ import annotations

import doctest
import math

import numpy as np
import pytest
import torch
from synthetic_matches import SyntheticVectorEnv
from tensordict import TensorDict
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    ExplorationType,
    GymWrapper,
    TransformedEnv,
    set_exploration_type,
)
from torchrl.objectives import ClipPPOLoss

import fbrl.models.actor_critic
import fbrl.models.collection_policy
import fbrl.models.impala
import fbrl.models.mlp
import fbrl.models.player_set
from fbrl.models import MLP, ActorCritic, ImpalaCNN, build_actor_critic
from fbrl.models.impala import max_pool_same
from fbrl.transforms import PLAYERS_FEATURES, MiniMapCells, Simple115, SuperMiniMap
from fbrl.transforms.minimap_grid import cells_to_planes

OBSERVATIONS = ("minimap", "smm", "simple115", "players")
WRITTEN = ("action", "action_log_prob", "state_value")


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def random_cells(*batch: int, frames: int = 4) -> torch.Tensor:
    return torch.randint(-1, 6912, (*batch, frames, 24), dtype=torch.int16)


def random_batch(*batch: int) -> TensorDict:
    cells = random_cells(*batch)
    return TensorDict(
        minimap_cells=cells,
        smm=cells_to_planes(cells),
        simple115=torch.randn(*batch, 115),
        players=torch.randn(*batch, len(PLAYERS_FEATURES)),
        batch_size=batch,
    )


def decisive(model: ActorCritic) -> ActorCritic:
    """The initial policy is nearly uniform; here actions differ in probability."""
    with torch.no_grad():
        model.get_policy_head()[0].module.weight.mul_(300)
    return model


# Networks


@pytest.mark.parametrize("observation", ["minimap", "smm"])
def test_parameters_number_as_many_as_in_gfootballs_network(observation):
    model = build_actor_critic(observation)
    assert sum(parameter.numel() for parameter in model.parameters()) == 396_868


def tensorflow_same_max_pool(x: np.ndarray) -> np.ndarray:
    """As TensorFlow documents SAME padding: the smaller half of it in front."""
    window, stride = 3, 2
    out = [math.ceil(size / stride) for size in x.shape]
    pads = [max((o - 1) * stride + window - n, 0) for o, n in zip(out, x.shape, strict=True)]
    padding = [(pad // 2, pad - pad // 2) for pad in pads]
    padded = np.pad(x, padding, constant_values=-np.inf)
    rows, columns = (range(0, o * stride, stride) for o in out)
    return np.array([[padded[r : r + window, c : c + window].max() for c in columns] for r in rows])


@pytest.mark.parametrize("height", [1, 2, 5, 9, 18, 72])
@pytest.mark.parametrize("width", [1, 6, 7, 12, 96])
def test_pooling_equals_tensorflows_same_padding(height, width):
    x = torch.randn(2, 3, height, width)
    pooled = max_pool_same(x)
    for sample in range(2):
        for channel in range(3):
            expected = tensorflow_same_max_pool(x[sample, channel].numpy())
            np.testing.assert_array_equal(pooled[sample, channel].numpy(), expected)


def written_out_impala(network: ImpalaCNN, planes: torch.Tensor) -> torch.Tensor:
    """gfootball/examples/models.py, line by line, with the parameters of ``network``."""

    def conv(module: nn.Conv2d, x: torch.Tensor) -> torch.Tensor:
        return nn.functional.conv2d(x, module.weight.contiguous(), module.bias, padding=1)

    convolutions = iter([m for m in network.modules() if isinstance(m, nn.Conv2d)])
    conv_out = planes.float() / 255
    for num_channels, num_blocks in [(16, 2), (32, 2), (32, 2), (32, 2)]:
        conv_out = conv(next(convolutions), conv_out)
        assert conv_out.shape[1] == num_channels
        maps = [[tensorflow_same_max_pool(c) for c in s] for s in conv_out.detach().numpy()]
        conv_out = torch.tensor(np.array(maps))
        for _ in range(num_blocks):
            block_input = conv_out
            conv_out = conv(next(convolutions), conv_out.relu())
            conv_out = conv(next(convolutions), conv_out.relu())
            conv_out = conv_out + block_input
    assert next(convolutions, None) is None
    return network.linear(conv_out.relu().flatten(1)).relu()


def test_features_equal_gfootballs_network_written_out():
    network = ImpalaCNN()
    planes = cells_to_planes(random_cells(3))
    expected = written_out_impala(network, planes)
    assert expected.std() > 0
    torch.testing.assert_close(network(planes), expected, rtol=1e-4, atol=1e-5)


def test_cells_and_dense_planes_give_the_same_features():
    network = ImpalaCNN()
    cells = random_cells(5)
    torch.testing.assert_close(network(cells), network(cells_to_planes(cells)))


def test_the_memory_layout_changes_neither_features_nor_gradients():
    channels_last = ImpalaCNN()
    contiguous = ImpalaCNN()
    contiguous.load_state_dict(channels_last.state_dict())
    contiguous.to(memory_format=torch.contiguous_format)
    first_conv = channels_last.stages[0].conv.weight
    assert first_conv.is_contiguous(memory_format=torch.channels_last)
    assert contiguous.stages[0].conv.weight.is_contiguous()
    cells = random_cells(4)
    outputs = [network(cells) for network in (channels_last, contiguous)]
    torch.testing.assert_close(*outputs, rtol=1e-4, atol=1e-5)
    for output in outputs:
        output.square().sum().backward()
    for one, other in zip(channels_last.parameters(), contiguous.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-3, atol=1e-4)


def test_bfloat16_comes_close_to_float32_in_features_and_gradients():
    exact, mixed = ImpalaCNN(), ImpalaCNN(precision="bfloat16")
    mixed.load_state_dict(exact.state_dict())
    cells = random_cells(16)
    outputs = [network(cells) for network in (exact, mixed)]
    assert outputs[1].dtype == torch.float32
    assert not torch.equal(*outputs)
    torch.testing.assert_close(*outputs, rtol=0.05, atol=0.01)
    for output in outputs:
        output.square().mean().backward()
    gradients = [
        torch.cat([parameter.grad.flatten() for parameter in network.parameters()])
        for network in (exact, mixed)
    ]
    assert gradients[1].dtype == torch.float32
    assert torch.cosine_similarity(*gradients, dim=0) > 0.99


def test_another_precision_is_refused():
    with pytest.raises(ValueError, match=r"precision is 'float16'.*'float32', 'bfloat16'"):
        ImpalaCNN(precision="float16")


@pytest.mark.parametrize("num_frames", [1, 2])
def test_the_number_of_stacked_frames_can_be_chosen(num_frames):
    model = build_actor_critic(MiniMapCells(num_frames))
    cells = random_cells(3, frames=num_frames)
    batch = model.get_collection_policy()(TensorDict(minimap_cells=cells, batch_size=[3]))
    assert batch["state_value"].shape == (3, 1)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (torch.zeros(2, 4, 24), r"torch.float32 of shape \(2, 4, 24\)"),
        (torch.zeros(2, 3, 24, dtype=torch.int16), r"int16 of shape \(2, 3, 24\).*MiniMapCells"),
        (torch.zeros(2, 72, 96, 16, dtype=torch.uint8), r"\(\*batch, 16, 72, 96\)"),
    ],
)
def test_other_observations_are_refused_with_what_is_allowed(wrong, message):
    with pytest.raises(ValueError, match=message):
        ImpalaCNN()(wrong)


def test_convolutions_start_from_sonnets_truncated_normal():
    network = ImpalaCNN()
    for module in (network.stages[3].residual_2.conv_2, network.linear):
        std = module.weight[0].numel() ** -0.5
        assert module.weight.abs().max() <= 2 * std
        # A normal distribution truncated at 2 has a standard deviation of 0.88.
        assert module.weight.std().item() / std == pytest.approx(0.88, abs=0.02)
        assert (module.bias == 0).all()


def test_heads_start_from_baselines_orthogonal_matrices():
    model = build_actor_critic("simple115")
    policy_head, value_head = model.get_policy_head()[0].module, model.get_value_head().module
    gram = policy_head.weight @ policy_head.weight.T
    torch.testing.assert_close(gram, 1e-4 * torch.eye(19))
    assert value_head.weight.norm().item() == pytest.approx(1, abs=1e-5)
    assert (policy_head.bias == 0).all()
    assert (value_head.bias == 0).all()


@pytest.mark.parametrize(("activation", "lowest"), [("tanh", -1.0), ("relu", 0.0)])
def test_the_perceptron_has_the_layers_and_the_activation_asked_for(activation, lowest):
    network = MLP((115,), (32, 64, 8), activation)
    sizes = [module.out_features for module in network if isinstance(module, nn.Linear)]
    assert sizes == [32, 64, 8]
    features = network(100 * torch.randn(500, 115))
    assert features.min().item() == pytest.approx(lowest, abs=1e-2)
    square = network[0].weight @ network[0].weight.T
    torch.testing.assert_close(square, 2 * torch.eye(32), rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("observation", "network"), [("simple115", "mlp"), ("players", "player_set")]
)
def test_a_normalised_perceptron_does_not_mind_the_size_of_its_weights(observation, network):
    model = build_actor_critic(observation, network, layer_norm=True, hidden_sizes=(16, 8))
    perceptron = next(module for module in model.modules() if isinstance(module, MLP))
    hidden = torch.randn(32, perceptron.num_inputs)
    before = perceptron(hidden)
    with torch.no_grad():
        for module in perceptron.modules():
            if isinstance(module, nn.Linear):
                module.weight *= 10
    torch.testing.assert_close(perceptron(hidden), before, rtol=1e-3, atol=1e-3)


def test_unknown_choices_are_named_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'pictures'.*simple115, players, minimap, smm, pixels"):
        build_actor_critic("pictures")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"'gelu'.*'tanh', 'relu'"):
        MLP(activation="gelu")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"hidden_sizes is \(\)"):
        MLP(hidden_sizes=())
    with pytest.raises(ValueError, match="num_actions is 0"):
        build_actor_critic("simple115", num_actions=0)


# Actor-critic


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_results_do_not_depend_on_the_shape_of_the_batch(observation):
    model = build_actor_critic(observation)
    policy = model.get_collection_policy()
    batch = random_batch(2, 3)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        results = policy(batch.clone())
        flat = policy(batch.reshape(-1))
        single = policy(batch[1, 2])
    for key in WRITTEN:
        torch.testing.assert_close(flat[key], results[key].flatten(0, 1))
        torch.testing.assert_close(single[key], results[key][1, 2])


@pytest.mark.parametrize("observation", OBSERVATIONS)
@pytest.mark.parametrize(
    "exploration", [None, ExplorationType.RANDOM, ExplorationType.DETERMINISTIC]
)
def test_the_collection_policy_equals_the_composed_operators_bit_for_bit(observation, exploration):
    model = decisive(build_actor_critic(observation))
    batch = random_batch(64 if observation in ("simple115", "players") else 6)
    results = []
    for operator in (model, model.get_collection_policy()):
        torch.manual_seed(3)
        with set_exploration_type(exploration), torch.no_grad():
            results.append(operator(batch.clone()))
    for key in WRITTEN:
        assert torch.equal(results[0][key], results[1][key])
        assert results[0][key].dtype == results[1][key].dtype


def test_actions_are_sampled_as_often_as_they_are_probable():
    model = decisive(build_actor_critic("simple115"))
    policy = model.get_collection_policy()
    observation = torch.randn(115).expand(40_000, 115)
    batch = policy(TensorDict(simple115=observation, batch_size=[40_000]))
    probabilities = model.get_policy_operator().get_dist(batch[:1].copy()).probs[0]
    assert probabilities.max() > 2 / 19
    counts = batch["action"].bincount(minlength=19)
    expected = 40_000 * probabilities
    chi_square = ((counts - expected) ** 2 / expected)[expected > 5].sum()
    # 18 degrees of freedom: exceeded once in 10,000 draws.
    assert chi_square < 48


def test_greedy_actions_are_the_most_probable_ones():
    model = decisive(build_actor_critic("simple115"))
    batch = random_batch(32)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        actions = model.get_collection_policy()(batch.clone())["action"]
    probabilities = model.get_policy_operator().get_dist(batch.clone()).probs
    assert torch.equal(actions, probabilities.argmax(-1))
    assert actions.unique().numel() > 1


def test_an_average_action_is_refused():
    policy = build_actor_critic("simple115").get_collection_policy()
    with set_exploration_type(ExplorationType.MEAN), pytest.raises(ValueError, match="RANDOM"):
        policy(random_batch(2))


def test_what_the_collection_policy_writes_is_small_and_without_gradients():
    batch = random_batch(2).select("simple115")
    written = build_actor_critic("simple115").get_collection_policy()(batch).exclude("simple115")
    assert set(written.keys()) == set(WRITTEN)
    assert not any(value.requires_grad for value in written.values())


def test_the_collection_policy_follows_the_training():
    model = build_actor_critic("simple115")
    policy = model.get_collection_policy()
    batch = random_batch(4)
    before = policy(batch.clone())["state_value"]
    optimiser = torch.optim.SGD(model.parameters(), lr=0.1)
    model.get_value_operator()(batch.clone())["state_value"].sum().backward()
    optimiser.step()
    after = model.get_value_operator()(batch.clone())["state_value"]
    assert not torch.equal(before, after)
    assert torch.equal(policy(batch.clone())["state_value"], after)


def ppo_gradients(model: ActorCritic, critic: nn.Module, batch: TensorDict) -> list[torch.Tensor]:
    loss = ClipPPOLoss(model.get_policy_operator(), critic, loss_critic_type="l2")
    losses = loss(batch)
    model.zero_grad()
    total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
    total.backward()
    gradients = [parameter.grad for parameter in model.parameters()]
    assert all(gradient is not None for gradient in gradients)
    return [gradient.clone() for gradient in gradients if gradient is not None]


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_the_ppo_loss_calls_the_trunk_once_and_reaches_every_parameter(observation):
    model = decisive(build_actor_critic(observation))
    batch = model.get_collection_policy()(random_batch(6))
    batch["advantage"], batch["value_target"] = torch.randn(6, 1), torch.randn(6, 1)
    calls: list[int] = []
    handle = model[0].module.register_forward_hook(lambda *_: calls.append(1))
    once = ppo_gradients(model, model.get_value_head(), batch)
    assert len(calls) == 1
    twice = ppo_gradients(model, model.get_value_operator(), batch)
    assert len(calls) == 3
    handle.remove()
    for one, two in zip(once, twice, strict=True):
        assert one.abs().max() > 0
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


def test_the_ppo_ratio_of_freshly_collected_actions_is_exactly_1():
    model = decisive(build_actor_critic("simple115"))
    batch = model.get_collection_policy()(random_batch(32))
    batch["advantage"], batch["value_target"] = torch.randn(32, 1), torch.randn(32, 1)
    losses = ClipPPOLoss(model.get_policy_operator(), model.get_value_head())(batch)
    assert losses["kl_approx"].item() == 0
    assert losses["max_ratio"].item() == 1


@pytest.mark.parametrize("observation", ["minimap", "smm", "simple115"])
def test_a_collector_runs_the_policy_on_the_transformed_observation(observation):
    base_env = GymWrapper(SyntheticVectorEnv(), categorical_action_encoding=True)
    env = TransformedEnv(base_env, Compose(SuperMiniMap(), Simple115()))
    policy = build_actor_critic(observation).get_collection_policy()
    collector = Collector(
        env,
        policy,
        frames_per_batch=12,
        total_frames=12,
        auto_register_policy_transforms=False,
    )
    (batch,) = [batch.clone() for batch in collector]
    collector.shutdown()
    assert env.action_spec.is_in(batch["action"][:, 0])
    assert batch["state_value"].shape == (3, 4, 1)
    recomputed = policy(batch.exclude(*WRITTEN))
    torch.testing.assert_close(batch["state_value"], recomputed["state_value"])


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_parameters_are_created_on_the_device_asked_for(observation):
    model = build_actor_critic(observation, device="meta")
    assert {parameter.device.type for parameter in model.parameters()} == {"meta"}


@pytest.mark.parametrize(
    "module",
    [
        fbrl.models.actor_critic,
        fbrl.models.impala,
        fbrl.models.mlp,
        fbrl.models.player_set,
        fbrl.models.collection_policy,
    ],
)
def test_documented_examples_run(module):
    outcome = doctest.testmod(module)
    assert outcome.attempted > 0
    assert outcome.failed == 0
