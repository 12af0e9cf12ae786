"""Recurrent learners: losses against plain loops, memories, and tasks that need memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from cue_games import LENGTH, Cues

from pursuit import Simulator, make_task
from pursuit.simulator.policy import DistributionPolicy, MemoryPolicy, TabularPolicy, play
from scripted_agents import AStarEvader
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.registry import ALGORITHMS, Build, entry
from train.algorithms.rollouts import TorchEngine
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat
from train.networks.recurrent import RecurrentCell
from train.networks.recurrent_policy import RecurrentPolicy
from train.runs.parts import settings_of
from train.settings.algorithms import PPOSettings

TASK = make_task("chase", maze="3x3", max_steps=7)


def make_env(games: int, seed: int = 0) -> SimulatorEnv:
    simulator = Simulator(TASK, games, seed, auto_restart=False)
    return SimulatorEnv(simulator, MazeSeat(TASK, "chaser"), [None, AStarEvader(epsilon=0.5)])


def make_network(env: Any, shared: bool = True) -> ActorCritic:
    torch.manual_seed(0)
    hidden = Hidden(16, recurrent="gru")
    network = ActorCritic(env.player.features, env.player.num_actions, hidden, shared)
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    return network


# -- sequences against plain loops -----------------------------------------------------------------


def test_a_cell_along_sequences_equals_its_steps_and_so_do_its_gradients() -> None:
    torch.manual_seed(1)
    cell = RecurrentCell(7).double()
    for weight in cell.parameters():
        weight.data.normal_(std=0.5)
    inputs = torch.randn(6, 9, 7, dtype=torch.double, requires_grad=True)
    state = torch.randn(6, cell.size, dtype=torch.double, requires_grad=True)
    fresh, counts = torch.rand(6, 9) < 0.3, torch.randn(6, 9, 7, dtype=torch.double)
    found, states = cell(inputs, state, fresh)
    outputs, now = [], state
    for step in range(9):
        now = torch.where(fresh[:, step, None], 0.0, now)
        output, now = cell.step(inputs[:, step], now)
        outputs.append(output)
        torch.testing.assert_close(states[:, step], now)
    expected = torch.stack(outputs, dim=1)
    torch.testing.assert_close(found, expected)
    leaves = [inputs, state, *cell.parameters()]
    ours, theirs = (torch.autograd.grad((out * counts).sum(), leaves) for out in (found, expected))
    for one, two in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, two)


@pytest.mark.parametrize("shared", [True, False])
def test_the_loss_of_ppo_over_sequences_equals_a_loop_over_steps(shared: bool) -> None:
    env = make_env(12)
    settings = PPOSettings(12, rollout_steps=10, minibatch_size=60, clip=0.05)
    learner = PPO(settings, env, make_network(env, shared), "cpu")
    network = learner.network
    learner.collect()  # so that the sequences below begin with something remembered
    frames = learner.collect()
    assert frames["episode_start"].any() and not frames["episode_start"].all(dim=1).any()
    with torch.no_grad():  # as after a gradient step
        for weight in network.parameters():
            weight.add_(0.05 * torch.randn_like(weight))
    ours = ppo_loss(network, frames, LossCoefficients(0.05, 0.5, 0.02))[0]
    advantage = frames["advantage"]
    advantage = (advantage - advantage.mean()) / advantage.std()
    state, terms = frames["state"], []
    own = network.sizes[0]
    for step in range(10):
        state = torch.where(frames["episode_start"][:, step, None], 0.0, state)
        prepared = frames["prepared"][:, step]
        hidden, value_hidden = network.hidden(prepared)
        assert network.policy_memory is not None
        hidden, policy_state = network.policy_memory.step(hidden, state[:, :own])
        if shared:
            value_hidden, state = hidden, policy_state
        else:
            assert network.value_memory is not None
            value_hidden, value_state = network.value_memory.step(value_hidden, state[:, own:])
            state = torch.cat([policy_state, value_state], dim=1)
        logs = network.policy_head(hidden).log_softmax(-1)
        log_prob = logs.gather(1, frames["action"][:, step, None]).squeeze(1)
        ratio = (log_prob - frames["action_log_prob"][:, step]).exp()
        paid = torch.minimum(
            ratio * advantage[:, step], ratio.clamp(0.95, 1.05) * advantage[:, step]
        )
        error = network.value_head(value_hidden).squeeze(1) - frames["value_target"][:, step]
        entropy = -(logs.exp() * logs).sum(-1)
        terms.append(-paid + 0.5 * error.square() - 0.02 * entropy)
    expected = torch.stack(terms).mean()
    torch.testing.assert_close(ours, expected)
    leaves = list(network.parameters())
    one, two = (torch.autograd.grad(loss, leaves, allow_unused=True) for loss in (ours, expected))
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-6)
    learner.close()


def test_memories_last_from_rollout_to_rollout_and_end_with_the_episode() -> None:
    env = make_env(8)
    network = make_network(env)
    learner = PPO(PPOSettings(8, rollout_steps=5, minibatch_size=40), env, network, "cpu")
    state, fresh, begun = torch.zeros(8, 16), torch.ones(8, dtype=torch.bool), 0
    for _ in range(4):
        assert isinstance(learner.engine, TorchEngine)
        rollout = learner.engine.collector.rollout()
        for step in range(5):
            assert torch.equal(rollout["episode_start"][:, step], fresh)
            state = torch.where(fresh[:, None], 0.0, state)
            with torch.no_grad():
                output, value, state = network.step(rollout["observation"][:, step], state)
            chosen = output.log_softmax(-1).gather(1, rollout["action"][:, step, None])
            torch.testing.assert_close(chosen.squeeze(1), rollout["action_log_prob"][:, step])
            torch.testing.assert_close(value.squeeze(1), rollout["value"][:, step])
            fresh = rollout["done"][:, step]
            begun += int(fresh.sum())
    assert begun > 8
    learner.close()


def test_final_observations_of_truncated_episodes_are_valued_with_the_memory() -> None:
    env = make_env(8)
    network = make_network(env, shared=False)
    learner = PPO(PPOSettings(8, rollout_steps=20, minibatch_size=40), env, network, "cpu")
    assert isinstance(learner.engine, TorchEngine)
    learner.engine.collector.keep_next = True
    rollout = learner.engine.collector.rollout()
    learner.close()
    cut = rollout["truncated"] & ~rollout["terminated"]
    assert cut[:, :-1].any()
    state = torch.zeros(8, sum(network.sizes))
    for step in range(20):
        state = torch.where(rollout["episode_start"][:, step, None], 0.0, state)
        with torch.no_grad():
            _, _, state = network.step(rollout["observation"][:, step], state)
            expected = network.step(rollout["next_observation"][:, step], state)[1].squeeze(1)
        ended = rollout["terminated"][:, step]
        apart = ~ended if step == 19 else cut[:, step]
        expected = torch.where(apart, expected, 0.0)
        torch.testing.assert_close(rollout["value_after"][:, step], expected)


def test_the_memory_of_a_policy_is_that_of_its_network_in_any_batch() -> None:
    env = make_env(4)
    network = make_network(env)
    policy = MazeSeat(TASK, "chaser").policy(network, greedy=False)
    assert isinstance(policy, RecurrentPolicy) and isinstance(policy, MemoryPolicy)
    assert not isinstance(policy, TabularPolicy) and not isinstance(policy, DistributionPolicy)
    whole, parts = Simulator(TASK, 10, seed=3), Simulator(TASK, 10, seed=3)
    halves = [np.arange(0, 10, 2), np.arange(1, 10, 2)]
    evader = AStarEvader(epsilon=0.5)
    for _ in range(20):
        actions, others = np.zeros((2, 10, 2), dtype=np.int32)
        whole.act([policy, evader], actions)
        view = parts.view("chaser")
        for half in halves:
            part = view.select(half)
            others[half, 0] = play(policy, part)
            view.streams[half] = part.streams
        others[:, 1] = play(evader, parts.view("evader"))
        assert (actions == others).all()
        whole.step(actions)
        parts.step(others)


def test_recurrent_policies_are_never_evaluated_exactly() -> None:
    env = make_env(4)
    contest = GameContest(TASK, "chaser", {"evader": AStarEvader(epsilon=0.5)}, 50)
    assert contest.is_table_duel
    remembering = MazeSeat(TASK, "chaser").policy(make_network(env))
    score = contest.score("learned", remembering)
    assert not score.exact and score.ci95 > 0.0
    against = GameContest(TASK, "evader", {"chaser": remembering}, 50)
    assert not against.is_table_duel and against.optimal() is None


# -- learning --------------------------------------------------------------------------------------


def reward_of(learner: Any, env: Cues) -> float:
    """The mean reward of the last steps of episodes over some rollouts."""
    engine = getattr(learner, "engine", learner)
    steps = [engine.collector.rollout() for _ in range(4)]
    return sum(float(step["reward"].sum()) for step in steps) / sum(
        int(step["done"].sum()) for step in steps
    )


@pytest.mark.parametrize("recurrent", [None, "gru"])
def test_ppo_solves_a_memory_task_only_with_a_recurrent_network(recurrent: str | None) -> None:
    torch.manual_seed(0)
    chosen: dict[str, Any] = {"num_games": 64, "width": 16, "minibatch_size": 256}
    settings = PPOSettings(**chosen, rollout_steps=8, gae_lambda=1.0, recurrent=recurrent)
    env = Cues(64)
    learner = entry("ppo").build(settings, env, Build(seed=1))  # type: ignore[arg-type]
    for step in range(60):
        learner.iterate(step / 60)
    paid = reward_of(learner, env)
    learner.close()
    assert LENGTH == 4 and (paid > 0.95 if recurrent else paid < 0.6), paid


# -- refusals --------------------------------------------------------------------------------------


def test_unsupported_recurrent_networks_are_refused() -> None:
    flat: dict[str, Any] = {"recurrent": "gru", "frames": 1000, "maze": "3x3"}
    with pytest.raises(ValueError, match="is not supported by q_learning; use ppo or a2c or "):
        settings_of(algorithm="q_learning", **flat)
    with pytest.raises(ValueError, match="unknown recurrent 'rnn'; one of gru"):
        settings_of(**{**flat, "recurrent": "rnn"})
    with pytest.raises(ValueError, match="not supported for an arm, which is fully observable"):
        settings_of(task="reacher", recurrent="gru", frames=1000)
    assert {name for name, one in ALGORITHMS.items() if one.recurrent} == {
        "ppo",
        "a2c",
        "ippo",
        "mappo",
    }


@pytest.mark.parametrize("encoding", ["index", "positions"])
@pytest.mark.parametrize("remembers", [True, False])
def test_cells_of_mazes_of_another_size_are_refused(encoding: str, remembers: bool) -> None:
    seat = MazeSeat(TASK, "chaser", encoding)
    hidden = Hidden(8, recurrent="gru" if remembers else None)
    policy: Any = seat.policy(ActorCritic(seat.features, seat.num_actions, hidden), greedy=True)
    for maze in ("2x2", "5x5"):  # their cells have numbers that mean others, or none
        simulator = Simulator(make_task("chase", maze=maze), 4, 0)
        with pytest.raises(ValueError, match="in mazes of 9 cells, but these have"):
            play(policy, simulator.view("chaser"))
        if not remembers:
            with pytest.raises(ValueError, match="mazes of 9 cells"):
                policy.distribution(simulator.task, simulator.games, 0)
