"""Minibatches of one frame, and of none where agents leave the game before it ends."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from pursuit import Simulator, make_task
from scripted_agents import AStarChaser
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.registry import Build, entry
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients, fused_actor_critic
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat

TASK = make_task("chase", maze="3x3", num_evaders=3, max_steps=12)


def evaders(games: int) -> SimulatorEnv:
    """Three evaders each that learn; a captured one has no frames until its game ends."""
    simulator = Simulator(TASK, games, 0, auto_restart=False)
    policies = [AStarChaser(), None, None, None]
    return SimulatorEnv(simulator, MazeSeat(TASK, "evader"), policies, members=3)


def learner_of(name: str, env: Any, **hyper: Any) -> Any:
    torch.manual_seed(0)
    given = {"num_games": 9, "width": 16, **hyper}
    return entry(name).build(entry(name).settings(**given), env, Build())


@pytest.mark.parametrize("standardize", [True, False])
@pytest.mark.parametrize("minibatch", [4, 8])
@pytest.mark.parametrize("recurrent", ["gru", None])
def test_weights_stay_finite_when_agents_leave(
    recurrent: str | None, minibatch: int, standardize: bool
) -> None:
    sizes = {"rollout_steps": 4, "minibatch_size": minibatch, "epochs": 2}
    rest = {"standardize_advantages": standardize, "recurrent": recurrent}
    learner = learner_of("ppo", evaders(3), **sizes, **rest)
    empty = 0
    for _ in range(8):
        frames, collect = learner.collect(), learner.collect
        if recurrent:
            empty += int((~frames["loss_mask"]).all(dim=1).sum())
        learner.collect = lambda frames=frames: frames
        figures = learner.iterate(0.0)
        learner.collect = collect
        assert all(map(math.isfinite, figures.values()))
    assert all(weight.isfinite().all() for weight in learner.network.parameters())
    if recurrent:
        assert empty > 0
    learner.close()


def test_an_episode_of_one_frame_gives_finite_weights() -> None:
    task = make_task("maze", maze="2x2", num_goals=1, max_steps=1)
    env = SimulatorEnv(Simulator(task, 1, 0, auto_restart=False), MazeSeat(task, "runner"), [None])
    learner = learner_of("reinforce", env, num_games=1)
    for _ in range(3):
        learner.iterate(0.0)
    assert all(weight.isfinite().all() for weight in learner.network.parameters())


def test_the_loss_of_one_frame_is_that_of_its_own_advantage() -> None:
    env = evaders(1)
    torch.manual_seed(0)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    fused = fused_actor_critic(network, "cpu")
    assert fused is not None
    frames = {
        "observation": env.reset()["observation"][:1],
        "action": torch.tensor([2]),
        "action_log_prob": torch.tensor([-1.3]),
        "advantage": torch.tensor([0.7]),
        "value_target": torch.tensor([0.2]),
    }
    raw = LossCoefficients(0.2, 0.5, 0.01, standardize=False)
    expected = ppo_loss(network, frames, raw)[1]
    for found in (
        ppo_loss(network, frames, raw._replace(standardize=True))[1],
        fused.set_gradients(frames, raw._replace(standardize=True)),
    ):
        for key, value in expected.items():
            torch.testing.assert_close(found[key], value)


def test_a_minibatch_without_frames_is_skipped() -> None:
    learner = learner_of("ppo", evaders(3), rollout_steps=4, minibatch_size=36, recurrent="gru")
    assert isinstance(learner, PPO)
    frames = learner.collect()
    frames["loss_mask"] = torch.zeros_like(frames["loss_mask"])
    learner.collect = lambda: frames  # type: ignore[method-assign]
    before = [weight.clone() for weight in learner.network.parameters()]
    assert learner.iterate(0.0) == {}
    for one, two in zip(before, learner.network.parameters(), strict=True):
        assert torch.equal(one, two)
    learner.close()
