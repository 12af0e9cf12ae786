"""Draws, rollouts and gradients that are written out, against autograd, TorchRL and plain loops."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.objectives import A2CLoss
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate
from torchrl_heads import actor_of, critic_of

from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import RandomAgent
from train.algorithms import dqn, ppo
from train.algorithms.a2c import A2C
from train.algorithms.advantages import fused_advantages
from train.algorithms.fused_rollouts import FusedEngine
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.rollouts import Frames
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import (
    FusedActorCritic,
    LossCoefficients,
    fused_actor_critic,
)
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat
from train.runs.parts import parts_of, settings_of
from train.runs.single import SingleAgent
from train.settings.algorithms import A2CSettings, PPOSettings

TASK = make_task("maze", maze="3x3", num_goals=2, max_steps=12)


def make_env(games: int, seed: int = 0, **seat: Any) -> SimulatorEnv:
    simulator = Simulator(TASK, games, seed, auto_restart=False)
    return SimulatorEnv(simulator, MazeSeat(TASK, "runner", **seat), [None])


def made(env: SimulatorEnv, **hidden: Any) -> tuple[ActorCritic, FusedActorCritic]:
    """A network with weights that are not near 0, and its fused form."""
    torch.manual_seed(0)
    network = ActorCritic(env.player.features, 4, Hidden(24, **hidden))
    with torch.no_grad():
        for weight in network.parameters():
            weight.add_(torch.randn_like(weight) * 0.3)
        network.policy_trunk.first.weight[-1] = 0.0  # type: ignore[index, union-attr]
    fused = fused_actor_critic(network, "cpu")
    assert fused is not None
    return network, fused


def some_frames(env: SimulatorEnv, batch: int) -> Frames:
    env.reset()
    seen = env.reset()["observation"]
    return {
        "observation": seen[torch.randint(len(seen), (batch,))],
        "action": torch.randint(4, (batch,)),
        "action_log_prob": torch.randn(batch) * 0.5 - 1.4,
        "advantage": torch.randn(batch) * 3.0 + 1.0,
        "value_target": torch.randn(batch),
    }


@pytest.mark.parametrize("stack", [1, 2])
def test_the_gradients_and_figures_are_those_of_ppos_loss(stack: int) -> None:
    env = make_env(300, frame_stack=stack)
    network, fused = made(env)
    frames = some_frames(env, 512)
    coefficients = LossCoefficients(0.3, 0.7, 0.05)
    loss, expected = ppo_loss(network, frames, coefficients)
    gradients = torch.autograd.grad(loss, list(network.parameters()))
    found = fused.set_gradients(frames, coefficients)
    assert 0.2 < expected["clip_fraction"] < 0.8
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=1e-4, atol=1e-5)
    for weight, gradient in zip(network.parameters(), gradients, strict=True):
        assert weight.grad is not None and gradient.abs().max() > 1e-3
        torch.testing.assert_close(weight.grad, gradient, rtol=1e-3, atol=1e-5)


def test_in_bfloat16_they_point_the_same_way() -> None:
    env = make_env(300)
    network, fused = made(env)
    frames = some_frames(env, 512)
    fused.set_gradients(frames, LossCoefficients(0.3, 0.7, 0.05))
    exact = torch.cat([weight.grad.flatten() for weight in network.parameters()])  # type: ignore[union-attr]
    _, rough = made(env, bfloat16=True)
    rough.set_gradients(frames, LossCoefficients(0.3, 0.7, 0.05))
    layer, below, _ = rough.layers
    assert rough.layers.bfloat16
    weights = (layer.weight, layer.bias, below.weight, below.bias)
    heads = (rough.policy, rough.value_head)
    found = [w.grad for w in (*weights, *(w for head in heads for w in head.parameters()))]
    near = torch.cat([one.flatten() for one in found])  # type: ignore[union-attr]
    assert torch.nn.functional.cosine_similarity(near, exact, dim=0) > 0.999
    assert not torch.equal(near, exact)


@pytest.mark.parametrize("standardize", [True, False])
def test_a2c_takes_the_same_step_by_kernels_and_by_torch_and_torchrl(standardize: bool) -> None:
    settings = A2CSettings(64, 0.9, standardize_advantages=standardize, entropy_coef=0.02)
    learners, figures, frames = [], [], {}
    for fused in (True, False):
        env = make_env(64)
        network, _ = made(env)
        learner = A2C(settings, env, network, fused=fused)
        assert learner.update_form == ("fused" if fused else "torch")
        frames = frames or learner.collect()
        learner.collect = lambda frames=frames: frames  # type: ignore[method-assign, misc]
        learners.append(learner)
        if not fused:
            hidden, value_hidden, _ = network.forward_sequence(frames)
            advantage = frames["advantage"][:, None]
            if standardize:
                advantage = (advantage - advantage.mean()) / advantage.std()
            content = {
                "policy_hidden": hidden,
                "value_hidden": value_hidden,
                "action": frames["action"],
                "advantage": advantage,
                "value_target": frames["value_target"][:, None],
            }
            theirs = A2CLoss(
                actor_of(network), critic_of(network), entropy_coeff=0.01, critic_coeff=0.5,
                loss_critic_type="l2",
            )(TensorDict(content, batch_size=[256]))  # fmt: skip
        figures.append(learner.iterate(0.5))
    assert figures[0] == pytest.approx(figures[1], rel=1e-4, abs=1e-5)
    for name, value in figures[1].items():
        assert value == pytest.approx(float(theirs[name].detach()), rel=1e-4, abs=1e-5), name
    for a, b in zip(*(one.network.parameters() for one in learners), strict=True):
        assert a.grad is not None and b.grad is not None
        torch.testing.assert_close(a.grad, b.grad, rtol=1e-3, atol=1e-5)


def test_actions_are_drawn_from_the_softmax_of_the_logits() -> None:
    env = make_env(1)
    network, fused = made(env)
    env.reset()
    seen = env.reset()["observation"].expand(40_000, -1).contiguous()
    drawn = fused.draw(seen)
    logits, value = network(seen[:1])
    share = torch.bincount(drawn.action, minlength=4) / 40_000
    torch.testing.assert_close(share, logits[0].softmax(-1), atol=0.012, rtol=0)
    assert (logits[0].softmax(-1) > 0.02).sum() >= 3
    torch.testing.assert_close(drawn.action_log_prob, logits[0].log_softmax(-1)[drawn.action])
    torch.testing.assert_close(drawn.value, value[0].expand(40_000))
    torch.testing.assert_close(fused.value(seen), drawn.value)


def test_advantages_are_those_of_torchrl() -> None:
    draw = np.random.default_rng(3)
    steps, games = 17, 40
    reward, cut_value = draw.normal(size=(2, steps, games)).astype(np.float32)
    value = draw.normal(size=(steps + 1, games)).astype(np.float32)
    ended, cut = draw.random((steps, games)) < 0.15, draw.random((steps, games)) < 0.15
    out = np.empty_like(reward)
    gamma, fade = 0.93, 0.8
    fused_advantages(reward, value, cut_value, ended, cut, np.array([gamma, gamma * fade]), out)
    following = np.where(cut, cut_value, value[1:])
    done = ended | cut
    columns = [value[:-1], following, reward, done, ended]
    theirs, _ = vec_generalized_advantage_estimate(
        gamma, fade, *(torch.from_numpy(column.T[..., None].copy()) for column in columns)
    )
    np.testing.assert_allclose(out, theirs[..., 0].T, rtol=1e-4, atol=1e-5)


def evaders(games: int) -> SimulatorEnv:
    """Teams of two that learn, of which one is often caught before the other."""
    task = make_task("chase", maze="4x4", num_chasers=2, num_evaders=2, max_steps=12)
    simulator = Simulator(task, games, 0, auto_restart=False)
    others = [RandomAgent(), RandomAgent(), None, None]
    return SimulatorEnv(simulator, MazeSeat(task, "evader"), others, members=2)


@pytest.mark.parametrize("team", [False, True], ids=["alone", "team"])
def test_rollouts_are_what_the_games_do_and_never_cross_an_episode(team: bool) -> None:
    games, steps, gamma, fade = 16, 30, 0.9, 0.8
    env, again = (evaders(games) if team else make_env(games) for _ in range(2))
    torch.manual_seed(0)
    network = ActorCritic(env.player.features, env.player.num_actions, Hidden(24))
    settings = PPOSettings(
        num_games=games, rollout_steps=steps, minibatch_size=64, gamma=gamma, gae_lambda=fade
    )
    learner = PPO(settings, env, network)
    now, take_step = again.reset(), env.step_tensors
    for _ in range(2):  # the second goes on where the first ended
        actions: list[torch.Tensor] = []
        env.step_tensors = lambda one, all_=actions: all_.append(one) or take_step(one)  # type: ignore[method-assign, func-returns-value, misc]
        frames = learner.collect()
        assert isinstance(learner.engine, FusedEngine)
        played = torch.stack(actions)  # of all, where frames are of those that count
        kept, counts, rewards, ends, following, values = [], [], [], [], [], []
        for step in range(steps):
            kept.append(now["observation"].clone())
            counts.append(~now["idle"].squeeze(-1) if team else torch.ones(games, dtype=torch.bool))
            values.append(network(kept[-1])[1].detach().squeeze(-1).numpy())
            stepped, now = again.step_and_maybe_reset(now.set("action", played[step]))
            after = stepped["next"]
            rewards.append(after["reward"].squeeze(-1).numpy())
            following.append(network(after["observation"])[1].detach().squeeze(-1).numpy())
            ends.append((after["terminated"].numpy().ravel(), after["done"].numpy().ravel()))
        counted = torch.stack(counts)
        assert counted.all() != team
        assert torch.equal(frames["observation"], torch.stack(kept)[counted])
        assert torch.equal(frames["action"], played[counted])
        assert any(t.any() for t, _ in ends) and any((d & ~t).any() for t, d in ends)
        expected = np.zeros(played.shape)
        ahead = np.zeros(played.shape[1])
        for step in reversed(range(steps)):
            terminated, done = ends[step]
            error = rewards[step] + gamma * ~terminated * following[step] - values[step]
            expected[step] = ahead = error + gamma * fade * ~done * ahead
        target = (expected + np.stack(values))[counted.numpy()]
        np.testing.assert_allclose(frames["advantage"], expected[counted.numpy()], 1e-3, 1e-4)
        np.testing.assert_allclose(frames["value_target"], target, rtol=1e-3, atol=1e-4)
    assert learner.frames == 2 * played.numel()


def test_levels_hear_of_the_advantages_of_every_game() -> None:
    env = make_env(8)
    network, _ = made(env)
    learner = PPO(PPOSettings(num_games=8, rollout_steps=16, minibatch_size=64), env, network)
    heard: list[Any] = []
    env.hook.wants_advantages = True
    env.hook.note_advantages = lambda *noted: heard.append(noted)  # type: ignore[method-assign]
    frames = learner.collect()
    ((noted, done),) = heard
    assert noted.shape == done.shape == (8, 16) and done.any()
    np.testing.assert_array_equal(noted.T.ravel(), frames["advantage"].numpy())


class Own(ActorCritic):
    """One that could draw and learn otherwise."""


class Careful(PPO):
    """Learns nothing: a rollout of its own."""

    def collect(self) -> Frames:
        frames = super().collect()
        frames["advantage"] = torch.zeros_like(frames["advantage"])
        return frames


class Alone(PPO):
    """An iteration of its own."""

    def iterate(self, progress: float) -> dict[str, float]:
        coefficients = LossCoefficients(0.2, 0.5, 0.01)
        loss, parts = ppo_loss(self.network, self.collect(), coefficients)
        self.descend(loss)
        return {name: float(value) for name, value in parts.items()}


class Twice(PPO):
    """A loss of its own."""

    def loss(self, minibatch: Frames, coefficients: LossCoefficients) -> tuple[torch.Tensor, Any]:
        loss, parts = super().loss(minibatch, coefficients)
        return 2.0 * loss, {**parts, "loss_objective": torch.tensor(123.0)}


def test_learners_that_users_build_on_these_are_called() -> None:
    settings = PPOSettings(num_games=16, rollout_steps=8, minibatch_size=128, entropy_coef=0.0)
    figures = []
    for form in (Careful, Alone, Twice):
        env = make_env(16)
        torch.manual_seed(0)
        network = ActorCritic(env.player.features, 4, Hidden(16))
        learner = form(settings, env, network)
        assert learner.update_form == ("fused" if form is Alone else "torch")
        before = network.policy_head.weight.detach().clone()
        figures.append(learner.iterate(0.0))
        changed = not torch.equal(before, network.policy_head.weight)
        assert changed == (form is not Careful)
        learner.close()
    assert figures[0]["loss_objective"] == 0.0 and figures[2]["loss_objective"] == 123.0
    assert figures[1]["kl_approx"] == pytest.approx(0.0, abs=1e-5)  # the draws are the network's


def test_weights_that_are_frozen_stay_as_they_are() -> None:
    env = make_env(16)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    settings = PPOSettings(num_games=16, rollout_steps=8, minibatch_size=64)
    learner = PPO(settings, env, network)
    assert learner.update_form == "fused"
    learner.iterate(0.0)
    network.policy_trunk.requires_grad_(False)
    before = [weight.detach().clone() for weight in network.parameters()]
    learner.iterate(0.0)
    for one, was in zip(network.parameters(), before, strict=True):
        assert torch.equal(one, was) != one.requires_grad


def test_a_trunk_with_more_layers_is_not_taken_for_one_that_is_written_out() -> None:
    env = make_env(16)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    assert fused_actor_critic(network, "cpu") is not None
    network.policy_trunk.rest.extend([nn.Linear(16, 16), nn.ReLU()])
    assert fused_actor_critic(network, "cpu") is None


@pytest.mark.parametrize(
    "other",
    [
        {"activation": "tanh"},
        {"recurrent": "gru"},
        {"shared": False},
        {"masks": True},
        {"observation": "planes"},
        {"kl_target": 0.01},
        {"critic": False},
        {"subclass": True},
    ],
    ids=lambda other: next(iter(other)),
)
def test_what_is_not_written_out_learns_as_before(other: dict[str, Any]) -> None:
    hidden = {k: v for k, v in other.items() if k in ("activation", "recurrent")}
    rest = {k: v for k, v in other.items() if k in ("kl_target", "critic")}
    seat: dict[str, Any] = {"mask_bumps": True} if "masks" in other else {}
    env: Any = make_env(16, **seat)
    if "observation" in other:
        env = make_env(16, encoding=other["observation"])
    torch.manual_seed(0)
    shared = other.get("shared", True)
    form = Own if "subclass" in other else ActorCritic
    network = form(env.player.features, 4, Hidden(16, **hidden), shared)
    settings = PPOSettings(num_games=16, rollout_steps=8, minibatch_size=64, **rest)
    learner = PPO(settings, env, network)
    assert learner.update_form == "torch"
    before = [weight.detach().clone() for weight in network.parameters()]
    assert math.isfinite(learner.iterate(0.0)["loss_objective"])
    assert any(not torch.equal(a, b) for a, b in zip(before, network.parameters(), strict=True))
    learner.close()


def test_ppo_takes_the_same_steps_by_kernels_and_by_torch() -> None:
    settings = PPOSettings(num_games=64, rollout_steps=8, minibatch_size=128)
    learners, figures, frames = [], [], {}
    for fused in (True, False):
        env = make_env(64)
        network, _ = made(env)
        learner = PPO(settings, env, network, fused=fused)
        assert learner.update_form == ("fused" if fused else "torch")
        frames = frames or {name: one.clone() for name, one in learner.collect().items()}
        learner.collect = lambda frames=frames: frames  # type: ignore[method-assign, misc]
        learners.append(learner)
        torch.manual_seed(1)  # of the order of the frames
        figures.append(learner.iterate(0.5))
    assert figures[0] == pytest.approx(figures[1], rel=1e-3, abs=1e-4)
    for a, b in zip(*(one.network.parameters() for one in learners), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn"])
def test_fused_off_takes_torch_and_the_loss_that_stands_there(
    algorithm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    small: dict[str, Any] = {"num_games": 32, "algorithm": algorithm, "maze": "3x3", "frames": 64}
    if algorithm == "ppo":
        small["minibatch_size"] = 64
    if algorithm == "dqn":
        small |= {"learning_starts": 32, "batch_size": 32}
    module, name = (dqn, "dqn_loss") if algorithm == "dqn" else (ppo, "ppo_loss")
    loss, found = getattr(module, name), []
    monkeypatch.setattr(module, name, lambda *given: found.append(1) or loss(*given))
    for fused, called in (("auto", algorithm == "dqn"), ("off", True)):
        trainee = SingleAgent(parts_of(settings_of(**small, fused=fused)), "greedy")
        assert trainee.learner.update_form == ("fused" if fused == "auto" else "torch")
        found.clear()
        trainee.iterate(SimpleNamespace(progress=0.0, scheduled=0.0, seconds=0.0))
        assert bool(found) == called
        trainee.close()
