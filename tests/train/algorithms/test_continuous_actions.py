"""On-policy learners of continuous actions: their losses against TorchRL's, and that they learn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule
from tensordict.nn import ProbabilisticTensorDictSequential as Sequential
from torch.distributions import Independent, Normal, kl_divergence
from torchrl.modules import TanhNormal
from torchrl.objectives import A2CLoss, ClipPPOLoss, ReinforceLoss
from torchrl_heads import NormalHead, critic_of, ours

from pursuit.reacher.policy import ArmPolicy, ArmView
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.registry import Build, entry
from train.algorithms.rollouts import TorchEngine
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic
from train.networks.arm_policy import ArmSeat
from train.networks.distributions import SquashedNormal
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden
from train.settings.algorithms import PPOSettings


def arm_env(games: int, joints: int = 1, **settings: Any) -> SimulatorEnv:
    task = ReacherTask(joints, **settings)
    return SimulatorEnv(ReacherSimulator(task, games, auto_restart=False), ArmSeat(task))


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
    found, parts = ppo_loss(network, ours(minibatch), LossCoefficients(0.2, 0.5, 0.0))
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
    torch.testing.assert_close(found, theirs, rtol=1e-4, atol=1e-5)
    assert_same_gradients(network, found, theirs)


def test_penalty_and_entropy_bonus_are_torchs_of_the_normals() -> None:
    network, minibatch = network_and_minibatch()
    plain = ppo_loss(network, ours(minibatch), LossCoefficients(0.2, 0.5, 0.0))[0]
    coefficients = LossCoefficients(0.2, 0.5, 0.01, kl_coef=0.7)
    found, parts = ppo_loss(network, ours(minibatch), coefficients)
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
    torch.testing.assert_close(found, plain + 0.7 * penalty - 0.01 * entropy)


@pytest.mark.parametrize("name", ["a2c", "reinforce"])
def test_the_gradients_of_a2c_and_reinforce_are_those_of_actions_after_tanh(name: str) -> None:
    network, minibatch = network_and_minibatch()
    parts = (tanh_actor(network), critic_of(network))
    if name == "a2c":
        losses = A2CLoss(*parts, critic_coeff=0.5, loss_critic_type="l2")(minibatch)
        names, value_coef = ["loss_objective", "loss_critic"], 0.5
    else:
        losses = ReinforceLoss(*parts, loss_critic_type="l2")(minibatch)
        names, value_coef = ["loss_actor", "loss_value"], 1.0
    coefficients = LossCoefficients(math.inf, value_coef, 0.0, standardize=False)
    found, _ = ppo_loss(network, ours(minibatch), coefficients)
    assert_same_gradients(network, found, sum(losses[key] for key in names))


# -- learning --------------------------------------------------------------------------------------


class RandomTurns:
    """Uniform turns."""

    def act(self, view: ArmView) -> Any:
        return np.stack([2.0 * view.uniform() - 1.0 for _ in range(view.task.joints)], axis=1)


def mean_steps(policy: ArmPolicy, joints: int = 1, arms: int = 500) -> float:
    """Of episodes from random poses."""
    simulator = ReacherSimulator(
        ReacherTask(joints, start="random"), arms, 2**62, auto_restart=False
    )
    lengths = np.zeros(arms)
    while (running := lengths == 0).any():
        simulator.step(policy.act(simulator.view()))
        ended = running & simulator.ended
        lengths[ended] = simulator.steps[ended]
    return float(lengths.mean())


APART = {"width": 32, "gamma": 0.9, "shared": False, "entropy_coef": 0.0, "learning_rate": 5e-3}
LEARNERS: dict[str, tuple[int, dict[str, Any]]] = {
    "ppo": (250_000, {**APART, "num_games": 256, "minibatch_size": 1024}),
    "a2c": (150_000, {**APART, "num_games": 256}),
    "reinforce": (100_000, {"num_games": 64, "width": 32, "gamma": 0.9}),
}


@pytest.mark.parametrize("name", LEARNERS)
def test_every_on_policy_learner_beats_random_turns_by_far(name: str) -> None:
    torch.manual_seed(1)
    frames, flat = LEARNERS[name]
    algorithm = entry(name)
    settings: Any = algorithm.settings(**flat)
    env = arm_env(settings.num_games, max_steps=100)  # the first episodes lead nowhere
    algorithm.check_actions(env.player)
    learner = algorithm.build(settings, env, Build(seed=1))
    while learner.frames < frames:
        figures = learner.iterate(learner.frames / frames)
    assert all(np.isfinite(list(figures.values())))
    loaded = algorithm.load(settings, env.player, learner.state_dict(), True)
    steps = mean_steps(learner.policy())  # type: ignore[arg-type]
    assert steps == mean_steps(loaded)  # type: ignore[arg-type]
    sampled = mean_steps(learner.policy(greedy=False))  # type: ignore[arg-type]
    learner.close()
    random = mean_steps(RandomTurns())
    assert steps < 0.3 * random and sampled < 0.3 * random


def test_without_a_critic_ppo_has_returns_for_advantages() -> None:
    env = arm_env(16, max_steps=8)
    settings = PPOSettings(16, 0.9, minibatch_size=64, rollout_steps=12, critic=False, width=8)
    learner = entry("ppo").build(settings, env, Build())
    assert isinstance(learner, PPO)
    assert isinstance(learner.engine, TorchEngine)
    collector = learner.engine.collector
    rollout = collector.rollout()
    collector.rollout = lambda: rollout  # type: ignore[method-assign]
    frames = learner.collect()
    reward, done = (rollout[key] for key in ("reward", "done"))
    expected, running = torch.zeros(16, 12), torch.zeros(16)
    for step in reversed(range(12)):
        running = reward[:, step] + 0.9 * torch.where(done[:, step], 0.0, running)
        expected[:, step] = running
    torch.testing.assert_close(frames["advantage"].reshape(16, 12), expected)
    _, parts = ppo_loss(learner.network, frames, LossCoefficients(0.2, None, 0.0))
    assert "loss_critic" not in parts
    learner.close()


def test_what_cannot_be_is_said() -> None:
    player = arm_env(4).player
    with pytest.raises(ValueError, match=r"action_std=0\.0; must be above 0"):
        PPOSettings(action_std=0.0)
    with pytest.raises(ValueError, match="does not support continuous actions; use ppo or a2c"):
        entry("q_learning").check_actions(player)
