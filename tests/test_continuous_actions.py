"""On-policy learners of continuous actions: their losses against TorchRL's, and that they learn."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule
from tensordict.nn import ProbabilisticTensorDictSequential as Sequential
from torch.distributions import Independent, Normal, kl_divergence
from torchrl.modules import TanhNormal
from torchrl.objectives import A2CLoss, ClipPPOLoss, ReinforceLoss

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from train.algorithms.a2c import A2C, Reinforce
from train.algorithms.ppo import ppo_loss
from train.environments.arm_env import ArmEnv
from train.networks.actor_critic import ActorCritic
from train.networks.arm_policy import ArmSeat
from train.networks.distributions import SquashedNormal
from train.networks.layers import Hidden
from train.networks.losses import NormalHead, critic_of
from train.settings.algorithms import A2CSettings, PPOSettings, ReinforceSettings


def arm_env(games: int, joints: int = 1, **settings: Any) -> ArmEnv:
    task = ReacherTask(joints, **settings)
    return ArmEnv(ReacherSimulator(task, games, auto_restart=False), ArmSeat(task))


def network_and_minibatch(joints: int = 2) -> tuple[ActorCritic, TensorDict]:
    """A policy that is not that which drew the actions of the frames."""
    torch.manual_seed(0)
    env = arm_env(256, joints)
    network = ActorCritic(env.player.features, joints, Hidden(16), action_std=0.5)
    with torch.no_grad():
        network.policy_head.weight.mul_(50)
    prepared = network.policy_trunk.prepare(env.reset()["observation"])
    before = SquashedNormal(0.3 * torch.randn(256, joints), torch.full((joints,), -0.5))
    drawn = before.draw()
    hidden, value_hidden = network.hidden(prepared)
    content = {
        "prepared": prepared,
        "drawn": drawn,
        "action": drawn.tanh(),
        "distribution": before.parameters,
        "action_log_prob": before.log_prob(drawn),
        "advantage": torch.randn(256, 1),
        "value_target": torch.randn(256, 1),
        "policy_hidden": hidden,
        "value_hidden": value_hidden,
    }
    return network, TensorDict(content, batch_size=[256])


def tanh_actor(network: ActorCritic) -> Sequential:
    """TorchRL's policy of actions, after tanh, with the factor of their density."""
    assert network.log_std is not None
    head = NormalHead(network.policy_head, network.log_std)
    keys = ["loc", "scale"]
    return Sequential(
        TensorDictModule(head, ["policy_hidden"], keys),
        ProbabilisticTensorDictModule(
            in_keys=keys, out_keys=["action"], distribution_class=TanhNormal, return_log_prob=True
        ),
    )


def assert_same_gradients(network: ActorCritic, ours: torch.Tensor, theirs: torch.Tensor) -> None:
    weights = [weight for weight in network.parameters() if weight.requires_grad]
    for a, b in zip(
        torch.autograd.grad(ours, weights, retain_graph=True),
        torch.autograd.grad(theirs, weights, retain_graph=True),
        strict=True,
    ):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-5)


def test_the_loss_of_ppo_and_its_gradients_equal_torchrls_of_actions_after_tanh() -> None:
    network, minibatch = network_and_minibatch()
    ours, parts = ppo_loss(network, minibatch, PPOSettings(clip=0.2), 0.0)
    assert 0.05 < parts["clip_fraction"] < 0.95
    mean, log_std = minibatch["distribution"].chunk(2, dim=-1)
    theirs_batch = minibatch.copy()
    collecting = TanhNormal(mean, log_std.exp())
    theirs_batch["action_log_prob"] = collecting.log_prob(minibatch["action"])
    loss = ClipPPOLoss(
        tanh_actor(network),
        critic_of(network),
        clip_epsilon=0.2,
        entropy_bonus=False,
        critic_coeff=0.5,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
    losses = loss(theirs_batch)
    theirs = losses["loss_objective"] + losses["loss_critic"]
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)
    assert_same_gradients(network, ours, theirs)


def test_penalty_and_entropy_bonus_are_torchs_of_the_normals() -> None:
    network, minibatch = network_and_minibatch()
    plain = ppo_loss(network, minibatch, PPOSettings(), 0.0)[0]
    ours, parts = ppo_loss(network, minibatch, PPOSettings(), 0.01, 0.7)
    assert network.log_std is not None
    mean, log_std = minibatch["distribution"].chunk(2, dim=-1)
    now = network.policy_head(minibatch["policy_hidden"])
    policies = [
        Independent(Normal(*numbers), 1)
        for numbers in ((mean, log_std.exp()), (now, network.log_std.exp().expand_as(now)))
    ]
    penalty = kl_divergence(*policies).mean()
    entropy = policies[1].entropy().mean()
    torch.testing.assert_close(parts["kl"], penalty.detach())
    torch.testing.assert_close(parts["entropy"], entropy.detach())
    torch.testing.assert_close(ours, plain + 0.7 * penalty - 0.01 * entropy)


@pytest.mark.parametrize("name", ["a2c", "reinforce"])
def test_the_gradients_of_a2c_and_reinforce_are_those_of_actions_after_tanh(name: str) -> None:
    network, minibatch = network_and_minibatch()
    env, parts = arm_env(4, 2), (tanh_actor(network), critic_of(network))
    own: A2C | Reinforce
    if name == "a2c":
        own = A2C(A2CSettings(4), env, network)
        losses = A2CLoss(*parts, critic_coeff=0.5, loss_critic_type="l2")(minibatch)
        names = ["loss_objective", "loss_critic"]
    else:
        own = Reinforce(ReinforceSettings(4), env, network)
        losses = ReinforceLoss(*parts, loss_critic_type="l2")(minibatch)
        names = ["loss_actor", "loss_value"]
    ours = own.loss(minibatch)
    own.close()
    assert_same_gradients(network, *(sum(part[key] for key in names) for part in (ours, losses)))
