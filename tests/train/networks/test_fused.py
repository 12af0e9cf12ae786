"""The hidden layers written out, and a step of Adam, against PyTorch's own."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch

from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from train.algorithms.adam import Adam
from train.algorithms.learner import clip_gradients
from train.networks.fused import fused_hidden, fused_layers
from train.networks.layers import Hidden, Trunk
from train.networks.policy import MazeSeat
from train.networks.q_network import QNetwork

TASK = make_task("maze", maze="5x5", num_goals=3)
FEATURES = MazeSeat(TASK, "runner").features


def observed(games: int, steps: int = 40) -> torch.Tensor:
    """[games, numbers]: some goals are collected, and so name no row."""
    simulator = Simulator(TASK, games, seed=2)
    actions = torch.randint(4, (steps, games, 1), generator=torch.Generator().manual_seed(1))
    for step in range(steps):
        simulator.step(actions[step].int().numpy())
    found = torch.from_numpy(simulator.observe("index", 0))
    assert (torch.from_numpy(FEATURES.rows)[found.long()] == FEATURES.num_rows).any()
    return found


@pytest.mark.parametrize("form", ["dense", "bag"])
def test_the_layers_and_their_gradients_equal_products_with_one_hots(form: str) -> None:
    torch.manual_seed(0)
    trunk = Trunk(FEATURES, Hidden(24, form=form))  # type: ignore[arg-type]
    layers = fused_layers(trunk)
    assert layers is not None
    with torch.no_grad():
        for weight in trunk.parameters():
            weight.copy_(torch.randn_like(weight) * 0.3)
    seen, over = observed(200), torch.randn(200, 24)
    table, bias, second, second_bias = trunk.parameters()
    rows = torch.from_numpy(FEATURES.rows)[seen.long()]
    one_hot = torch.nn.functional.one_hot(rows, len(table)).sum(1).float()
    first = (one_hot[:, :-1] @ table[:-1] + bias).relu()
    expected = (first @ second.T + second_bias).relu()
    ours = fused_hidden(layers, seen)
    torch.testing.assert_close(ours, expected)
    leaves = list(trunk.parameters())
    gradients = [torch.autograd.grad((out * over).sum(), leaves) for out in (ours, expected)]
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-4)
    assert not gradients[0][0][-1].any()
    with torch.no_grad():
        assert torch.equal(fused_hidden(layers, seen), ours)


def test_in_bfloat16_they_are_as_near_as_it_is_exact() -> None:
    torch.manual_seed(0)
    trunk = Trunk(FEATURES, Hidden(32))
    half = Trunk(FEATURES, Hidden(32, bfloat16=True))
    half.load_state_dict(trunk.state_dict())
    seen, found = observed(300), []
    for one in (trunk, half):
        layers = fused_layers(one)
        assert layers is not None
        hidden = fused_hidden(layers, seen)
        assert hidden.dtype == torch.float32
        found.append((hidden, *torch.autograd.grad(hidden.square().mean(), list(one.parameters()))))
    for exact, rounded in zip(*found, strict=True):
        assert exact.shape == rounded.shape and rounded.dtype == torch.float32
        assert float((exact - rounded).detach().norm() / exact.detach().norm()) < 0.02


@pytest.mark.parametrize("hidden", [Hidden(16), Hidden(16, activation="tanh")], ids=str)
@pytest.mark.parametrize("dueling", [False, True])
def test_quick_action_values_are_action_values(hidden: Hidden, dueling: bool) -> None:
    torch.manual_seed(0)
    network = QNetwork(FEATURES, 4, hidden, dueling)
    seen = observed(100)
    values, quick = network(seen), network.forward_inference(seen)
    torch.testing.assert_close(quick, values)
    leaves = list(network.parameters())
    one, two = (torch.autograd.grad(out.square().sum(), leaves) for out in (values, quick))
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)
    with torch.no_grad():
        torch.testing.assert_close(network.forward_inference(seen), values)


def test_adam_is_torchs_own_bit_for_bit() -> None:
    torch.manual_seed(0)
    ours = QNetwork(FEATURES, 4, Hidden(16))
    theirs = deepcopy(ours)
    own = Adam(ours.parameters(), 3e-3, (0.8, 0.99), 1e-5)
    torchs = torch.optim.Adam(theirs.parameters(), 3e-3, (0.8, 0.99), 1e-5, fused=True)
    seen = observed(50)
    for number in range(4):
        own.param_groups[0]["lr"] = torchs.param_groups[0]["lr"] = 3e-3 / (1 + number)
        for network, optimizer in ((ours, own), (theirs, torchs)):
            optimizer.zero_grad()
            network(seen).square().mean().backward()
            optimizer.step()
        if number == 1:  # checkpoints of the one are those of the other
            states = deepcopy(own.state_dict()), deepcopy(torchs.state_dict())
            assert list(states[0]["param_groups"][0]) == list(states[1]["param_groups"][0])
            assert states[0]["param_groups"] == states[1]["param_groups"]
            own = Adam(ours.parameters(), 1.0)
            own.load_state_dict(states[1])
            torchs.load_state_dict(states[0])
    for a, b in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert torch.equal(a, b)
    moments = [optimizer.state_dict()["state"] for optimizer in (own, torchs)]
    assert list(moments[0]) == list(moments[1]) == [*range(len(own.weights))]
    for number, by_name in moments[0].items():
        assert list(by_name) == list(moments[1][number])
        for name, tensor in by_name.items():
            assert torch.equal(tensor, moments[1][number][name]), name


def test_adam_leaves_weights_without_a_gradient() -> None:
    weights = [torch.nn.Parameter(torch.ones(3)) for _ in range(2)]
    optimizer = Adam(weights, 0.1)
    for _ in range(3):
        optimizer.zero_grad()
        weights[0].sum().backward()
        optimizer.step()
    assert (weights[0] < 1.0).all() and torch.equal(weights[1], torch.ones(3))
    assert [*optimizer.state_dict()["state"]] == [0]


@pytest.mark.parametrize("other", [[3], [3, 4], [3, 3, 3]])
def test_adam_takes_no_state_of_other_weights(other: list[int]) -> None:
    states = []
    for sizes in ([3, 3], other):
        weights = [torch.nn.Parameter(torch.ones(size)) for size in sizes]
        optimizer = Adam(weights, 0.1)
        torch.autograd.backward([weight.sum() for weight in weights])
        optimizer.step()
        states.append(optimizer.state_dict())
    with pytest.raises(ValueError, match="weight"):
        optimizer.load_state_dict(states[0])


@pytest.mark.parametrize("most", [0.1, 1e3])
def test_gradients_are_scaled_down_as_torch_does(most: float) -> None:
    weights = [torch.nn.Parameter(torch.zeros(size)) for size in (3, 40)]
    for weight in weights:
        weight.grad = torch.randn(
            weight.shape, generator=torch.Generator().manual_seed(len(weight))
        )
    theirs = deepcopy(weights)
    for mine, weight in zip(weights, theirs, strict=True):
        weight.grad = mine.grad.clone() if mine.grad is not None else None
    clip_gradients(weights, most)
    torch.nn.utils.clip_grad_norm_(theirs, most)
    for mine, weight in zip(weights, theirs, strict=True):
        torch.testing.assert_close(mine.grad, weight.grad)
