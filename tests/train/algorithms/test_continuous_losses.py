"""The losses of DDPG, TD3 and SAC, their gradients and targets, against TorchRL's."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import DDPGLoss, SACLoss, SoftUpdate, TD3Loss

from train.algorithms.continuous_losses import (
    critic_loss,
    deterministic_actor_loss,
    next_action,
    soft_actor_loss,
    temperature_loss,
)
from train.algorithms.learner import clip_gradients
from train.algorithms.replay import returns_to_expect
from train.networks.continuous import Critics, DeterministicActor, GaussianActor, polyak_update
from train.networks.features import Features
from train.networks.layers import Hidden

ROWS, GAMMA = 128, 0.9
FEATURES = Features("flat", (5,), np.full(5, 2.0))


class Critic(nn.Module):
    """Number `index` of stacked critics alone, as a network of TorchRL's."""

    def __init__(self, critics: Critics, index: int, actor: Any) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(7, 16), nn.ReLU(), nn.Linear(16, 16), nn.ReLU())
        self.layers.append(nn.Linear(16, 1))
        self.prepare = actor.trunk.prepare
        with torch.no_grad():
            for layer, weight, bias in zip(
                self.layers[::2], critics.weights, critics.biases, strict=True
            ):
                layer.weight.copy_(weight[index].T)
                layer.bias.copy_(bias[index, 0])

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """[..., 1]."""
        value: torch.Tensor = self.layers(torch.cat([self.prepare(observation), action], dim=-1))
        return value


class Parts(nn.Module):
    """A `GaussianActor` as TorchRL wants it: mean and standard deviation."""

    def __init__(self, actor: GaussianActor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both [..., actions]."""
        mean, log_std = self.actor(self.actor.trunk.prepare(observation))
        return mean, log_std.exp()


class Action(nn.Module):
    """A `DeterministicActor` as TorchRL wants it."""

    def __init__(self, actor: DeterministicActor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions]."""
        return self.actor.act(observation)


def shaken(network: Any) -> Any:
    with torch.no_grad():
        for weight in network.parameters():
            weight.add_(0.2 * torch.randn_like(weight))
    return network


def make_batch(weighted: bool) -> tuple[TensorDict, TensorDict]:
    """Ours and TorchRL's form of the same transitions."""
    batch = TensorDict(
        {
            "observation": torch.randn(ROWS, 5),
            "action": torch.rand(ROWS, 2) * 2 - 1,
            "reward": torch.randn(ROWS),
            "next_observation": torch.randn(ROWS, 5),
            "terminated": torch.rand(ROWS) < 0.3,
            "steps": torch.randint(1, 4, (ROWS,)),
        },
        batch_size=[ROWS],
    )
    ended = batch["terminated"][:, None]
    theirs = TensorDict(
        {
            "observation": batch["observation"],
            "action": batch["action"],
            "steps_to_next_obs": batch["steps"][:, None],
            "next": {
                "observation": batch["next_observation"],
                "reward": batch["reward"][:, None],
                "terminated": ended,
                "done": ended,
            },
        },
        batch_size=[ROWS],
    )
    if weighted:
        batch["priority_weight"] = theirs["priority_weight"] = torch.rand(ROWS) + 0.1
    return batch, theirs


def critic_modules(critics: Critics, actor: Any) -> list[TensorDictModule]:
    return [
        TensorDictModule(
            Critic(critics, index, actor), ["observation", "action"], ["state_action_value"]
        )
        for index in range(len(critics.weights[0]))
    ]


def fill(parameters: Any, modules: list[Any]) -> None:
    """Put the weights of one module, or of several stacked, into a loss's own parameters."""
    states = [dict(module.named_parameters()) for module in modules]
    for name, weight in parameters.flatten_keys(".").items():
        if name not in states[0]:  # a buffer
            continue
        rows = [state[name].detach() for state in states]
        weight.data.copy_(rows[0] if weight.shape == rows[0].shape else torch.stack(rows))


def check_critics(loss: torch.Tensor, critics: Critics, theirs: Any, parameters: Any) -> None:
    """The same gradients of all weights of all critics."""
    ours = torch.autograd.grad(loss, [*critics.weights, *critics.biases])
    flat, mine = parameters.flatten_keys("."), iter(ours)
    names = [f"module.layers.{layer}" for layer in (0, 2, 4)]
    for name in names:
        found = torch.autograd.grad(theirs, flat[f"{name}.weight"], retain_graph=True)[0]
        weight = next(mine)
        other = found.reshape(len(weight), *found.shape[-2:]).transpose(1, 2)
        torch.testing.assert_close(weight, other, rtol=1e-4, atol=1e-6)
    for name in names:
        found = torch.autograd.grad(theirs, flat[f"{name}.bias"], retain_graph=True)[0]
        bias = next(mine)
        torch.testing.assert_close(bias, found.reshape(bias.shape), rtol=1e-4, atol=1e-6)


def check_actor(ours: torch.Tensor, actor: Any, theirs: torch.Tensor, parameters: Any) -> None:
    mine = torch.autograd.grad(ours, list(actor.parameters()))
    flat = parameters.flatten_keys(".")
    ends = {name: next(key for key in flat.keys() if key.endswith(name))  # noqa: SIM118
            for name, _ in actor.named_parameters()}  # fmt: skip
    wanted = [flat[ends[name]] for name, _ in actor.named_parameters()]
    for a, b in zip(mine, torch.autograd.grad(theirs, wanted), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_losses_of_ddpg_equal_torchrls(weighted: bool) -> None:
    torch.manual_seed(0)
    actor = shaken(DeterministicActor(FEATURES, 2, Hidden(16)))
    critics = shaken(Critics(FEATURES, 2, Hidden(16), 1))
    target_actor, target_critics = shaken(deepcopy(actor)), shaken(deepcopy(critics))
    batch, their_batch = make_batch(weighted)
    acting = TensorDictModule(Action(actor), ["observation"], ["action"])
    loss = DDPGLoss(acting, critic_modules(critics, actor)[0], delay_actor=True, delay_value=True)
    loss.make_value_estimator(gamma=GAMMA)
    fill(loss.target_actor_network_params,
         [TensorDictModule(Action(target_actor), ["observation"], ["action"])])  # fmt: skip
    fill(loss.target_value_network_params, critic_modules(target_critics, actor))
    found = loss(their_batch)
    prepare = actor.trunk.prepare
    prepared, following = prepare(batch["observation"]), prepare(batch["next_observation"])
    action = next_action(target_actor, following, 0.0, 0.0)
    goal = returns_to_expect(batch, target_critics(following, action)[0].detach(), GAMMA)
    ours, error = critic_loss(critics(prepared, batch["action"]), goal, batch)
    torch.testing.assert_close(ours, found["loss_value"])
    torch.testing.assert_close(error.square(), their_batch["td_error"])
    check_critics(ours, critics, found["loss_value"], loss.value_network_params)
    ours = deterministic_actor_loss(actor, critics, prepared, batch)
    torch.testing.assert_close(ours, found["loss_actor"])
    check_actor(ours, actor, found["loss_actor"], loss.actor_network_params)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_losses_of_td3_equal_torchrls(weighted: bool) -> None:
    torch.manual_seed(0)
    actor = shaken(DeterministicActor(FEATURES, 2, Hidden(16)))
    critics = shaken(Critics(FEATURES, 2, Hidden(16), 2))
    target_actor, target_critics = shaken(deepcopy(actor)), shaken(deepcopy(critics))
    batch, their_batch = make_batch(weighted)
    loss = TD3Loss(
        TensorDictModule(Action(actor), ["observation"], ["action"]),
        critic_modules(critics, actor),
        bounds=(-1.0, 1.0),
        policy_noise=0.7,
        noise_clip=0.5,
        delay_actor=True,
        delay_qvalue=True,
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=GAMMA)
    fill(loss.target_actor_network_params,
         [TensorDictModule(Action(target_actor), ["observation"], ["action"])])  # fmt: skip
    fill(loss.target_qvalue_network_params, critic_modules(target_critics, actor))
    torch.manual_seed(7)
    found = loss(their_batch)
    prepare = actor.trunk.prepare
    prepared, following = prepare(batch["observation"]), prepare(batch["next_observation"])
    torch.manual_seed(7)
    action = next_action(target_actor, following, 0.7, 0.5)
    goal = returns_to_expect(batch, target_critics(following, action).amin(0).detach(), GAMMA)
    ours, error = critic_loss(critics(prepared, batch["action"]), goal, batch)
    torch.testing.assert_close(ours, found["loss_qvalue"])
    torch.testing.assert_close(error.square(), their_batch["td_error"])
    check_critics(ours, critics, found["loss_qvalue"], loss.qvalue_network_params)
    ours = deterministic_actor_loss(actor, critics, prepared, batch)
    torch.testing.assert_close(ours, found["loss_actor"])
    check_actor(ours, actor, found["loss_actor"], loss.actor_network_params)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_losses_of_sac_equal_torchrls(weighted: bool) -> None:
    torch.manual_seed(0)
    actor = shaken(GaussianActor(FEATURES, 2, Hidden(16)))
    critics = shaken(Critics(FEATURES, 2, Hidden(16), 2))
    target_critics = shaken(deepcopy(critics))
    batch, their_batch = make_batch(weighted)
    acting = ProbabilisticActor(
        TensorDictSequential(TensorDictModule(Parts(actor), ["observation"], ["loc", "scale"])),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"upscale": 1e6, "tanh_loc": False},
        return_log_prob=True,
    )
    loss = SACLoss(
        acting, critic_modules(critics, actor), loss_function="l2", alpha_init=0.3,
        target_entropy=-2.0, delay_qvalue=True,
    )  # fmt: skip
    loss.make_value_estimator(gamma=GAMMA)
    fill(loss.target_qvalue_network_params, critic_modules(target_critics, actor))
    torch.manual_seed(7)
    found = loss(their_batch)
    log_alpha = torch.tensor(0.3).log().requires_grad_()
    alpha = log_alpha.detach().exp()
    prepare = actor.trunk.prepare
    prepared, following = prepare(batch["observation"]), prepare(batch["next_observation"])
    torch.manual_seed(7)
    with torch.no_grad():
        action, log_prob = actor.draw(following)
        values = target_critics(following, action).amin(0) - alpha * log_prob
    goal = returns_to_expect(batch, values, GAMMA)
    ours, error = critic_loss(critics(prepared, batch["action"]), goal, batch)
    torch.testing.assert_close(ours, found["loss_qvalue"], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(error, their_batch["td_error"], rtol=1e-4, atol=1e-4)
    check_critics(ours, critics, found["loss_qvalue"], loss.qvalue_network_params)
    ours, log_prob = soft_actor_loss(actor, critics, prepared, batch, alpha)
    torch.testing.assert_close(ours, found["loss_actor"], rtol=1e-4, atol=1e-5)
    check_actor(ours, actor, found["loss_actor"], loss.actor_network_params)
    ours = temperature_loss(log_alpha, log_prob, -2.0, batch)
    torch.testing.assert_close(ours, found["loss_alpha"], rtol=1e-4, atol=1e-5)
    mine = torch.autograd.grad(ours, log_alpha)[0]
    other = torch.autograd.grad(found["loss_alpha"], loss.log_alpha)[0]
    torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)


def test_densities_of_squashed_draws_equal_those_of_the_change_of_variables() -> None:
    torch.manual_seed(0)
    actor = shaken(GaussianActor(FEATURES, 2, Hidden(16)))
    prepared = actor.trunk.prepare(torch.randn(500, 5))
    action, log_prob = actor.draw(prepared)
    mean, log_std = (part.double() for part in actor(prepared))
    before = action.double().clamp(-1 + 1e-7, 1 - 1e-7).atanh()
    normal = torch.distributions.Normal(mean, log_std.exp()).log_prob(before)
    expected = (normal - (1 - before.tanh().square()).log()).sum(-1)
    inside = (action.abs() < 0.999).all(-1)
    assert inside.sum() > 100 and log_prob.isfinite().all()
    torch.testing.assert_close(log_prob[inside].double(), expected[inside], rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("tau", [0.0, 0.01, 0.3, 1.0])
def test_targets_follow_as_torchrls_soft_update_has_them(tau: float) -> None:
    torch.manual_seed(0)
    actor = shaken(DeterministicActor(FEATURES, 2, Hidden(16)))
    critics = shaken(Critics(FEATURES, 2, Hidden(16), 2))
    acting = TensorDictModule(Action(actor), ["observation"], ["action"])
    modules = critic_modules(critics, actor)
    loss = TD3Loss(acting, modules, bounds=(-1.0, 1.0), delay_actor=True, delay_qvalue=True)
    updater = SoftUpdate(loss, tau=tau)
    target = deepcopy(actor)
    with torch.no_grad():  # the network moves on, and its targets are to follow
        for weight in actor.parameters():
            weight.add_(0.2 * torch.randn_like(weight))
    fill(loss.actor_network_params, [acting])
    for _ in range(3):
        updater.step()
        polyak_update(target, actor, tau)
    ours = dict(target.named_parameters())
    for name, weight in loss.target_actor_network_params.flatten_keys(".").items():
        mine = ours.get(name.removeprefix("module.actor."))
        if mine is not None:  # a buffer
            torch.testing.assert_close(mine.detach(), weight.detach(), rtol=1e-5, atol=1e-6)


def test_stacked_critics_are_networks_of_their_own() -> None:
    torch.manual_seed(0)
    critics = shaken(Critics(FEATURES, 2, Hidden(16, "tanh"), 3))
    prepared, action = torch.randn(10, 5), torch.randn(10, 2)
    together = critics(prepared, action)
    for index in range(3):
        hidden = torch.cat([prepared, action], dim=-1)
        for weight, bias in zip(list(critics.weights)[:2], list(critics.biases)[:2], strict=True):
            hidden = (hidden @ weight[index] + bias[index]).tanh()
        alone = (hidden @ critics.weights[2][index] + critics.biases[2][index]).squeeze(-1)
        torch.testing.assert_close(together[index], alone)
    judged = critics.frozen(prepared, action.requires_grad_(), 2)
    torch.testing.assert_close(judged, together[:2])
    judged.sum().backward()
    assert action.grad is not None and all(part.grad is None for part in critics.parameters())
    planes = Features("planes", (3, 4, 4), np.ones(48))
    with pytest.raises(ValueError, match="kind 'planes'"):
        Critics(planes, 2, Hidden(16), 2)


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_critics_in_bfloat16_are_the_same_to_its_precision(activation: str) -> None:
    torch.manual_seed(0)
    exact = Critics(FEATURES, 2, Hidden(16, activation), 2)
    rounded = Critics(FEATURES, 2, Hidden(16, activation, bfloat16=True), 2)
    rounded.load_state_dict(exact.state_dict())
    given = torch.randn(50, 5), torch.randn(50, 2)
    values = rounded(*given)
    assert values.dtype == torch.float32
    torch.testing.assert_close(values, exact(*given), rtol=0.05, atol=0.05)


def test_gradients_are_clipped_as_torch_does_it() -> None:
    for scale in (0.01, 10.0):
        weights = [nn.Parameter(torch.zeros(size)) for size in (3, 50, 7)]
        others = [nn.Parameter(torch.zeros(size)) for size in (3, 50, 7)]
        for one, other in zip(weights, others, strict=True):
            one.grad = scale * torch.randn_like(one)
            other.grad = one.grad.clone()
        clip_gradients(weights, 1.0)
        nn.utils.clip_grad_norm_(others, 1.0)
        for one, other in zip(weights, others, strict=True):
            torch.testing.assert_close(one.grad, other.grad)
