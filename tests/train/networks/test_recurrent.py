"""Learners that remember: their losses against plain loops, their memories, and what they solve."""

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
from train.algorithms.recurrent_dqn import sequence_loss
from train.algorithms.registry import ALGORITHMS, Build, entry
from train.algorithms.rollouts import TorchUpdate
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden
from train.networks.policy import Seat
from train.networks.recurrent import GATES, Cell
from train.networks.remembering import RememberingPolicy
from train.runs.parts import settings_of
from train.settings.algorithms import DQNSettings, PPOSettings

TASK = make_task("chase", maze="3x3", max_steps=7)


def make_env(games: int, seed: int = 0) -> SimulatorEnv:
    simulator = Simulator(TASK, games, seed, auto_restart=False)
    return SimulatorEnv(simulator, Seat(TASK, "chaser"), [None, AStarEvader(epsilon=0.5)])


def make_network(env: Any, kind: str = "gru", shared: bool = True) -> ActorCritic:
    torch.manual_seed(0)
    hidden = Hidden(16, recurrent=kind)
    network = ActorCritic(env.player.features, env.player.num_actions, hidden, shared)
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    return network


# -- sequences against plain loops -----------------------------------------------------------------


@pytest.mark.parametrize("kind", GATES)
def test_a_cell_along_sequences_equals_its_steps_and_so_do_its_gradients(kind: str) -> None:
    torch.manual_seed(1)
    cell = Cell(kind, 7).double()
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
@pytest.mark.parametrize("kind", GATES)
def test_the_loss_of_ppo_over_sequences_equals_a_loop_over_steps(kind: str, shared: bool) -> None:
    env = make_env(12)
    settings = PPOSettings(12, rollout_steps=10, minibatch_size=60, clip=0.05)
    learner = PPO(settings, env, make_network(env, kind, shared), "cpu")
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


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("kind", GATES)
def test_the_loss_of_dqn_over_sequences_equals_a_loop_over_steps(kind: str, double: bool) -> None:
    torch.manual_seed(0)
    env = make_env(6)
    settings = DQNSettings(
        6, 0.9, kind, rollout_steps=9, burn_in=4, n_steps=3, batch_size=36, buffer_size=540,
        double=double, learning_starts=10**9,
    )  # fmt: skip
    learner: Any = entry("dqn").build(settings, env, Build())  # type: ignore[arg-type]
    rollouts = [learner.collector.rollout()]
    learner.remember(rollouts[0])
    rollouts.append(learner.collector.rollout())
    learner.remember(rollouts[1])
    learner.close()
    network, target = learner.network, learner.target
    with torch.no_grad():
        for weight in target.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    # The second rollout, warmed up by the last four steps of the first one.
    batch = {name: column[6:] for name, column in learner.replay.columns().items()}
    ours, size = sequence_loss(network, target, batch, settings)
    first, second = rollouts
    assert (second["truncated"] & ~second["terminated"]).any()
    goals, values = torch.zeros(2, 6, 9), torch.zeros(6, 9)
    for game in range(6):
        state = torch.zeros(1, network.sizes[0])
        for step in range(5):  # what was remembered four steps before the end of the first
            state = torch.where(first["episode_start"][game, step], 0.0, state)
            state = network.remember(first["observation"][game, step][None], state)[1].detach()
        own = theirs = state
        for step in range(5, 9):
            own, theirs = (
                torch.where(first["episode_start"][game, step], 0.0, now) for now in (own, theirs)
            )
            seen = first["observation"][game, step][None]
            own, theirs = network.remember(seen, own)[1], target.remember(seen, theirs)[1]
        after = []
        for step in range(9):
            row = {name: column[game, step] for name, column in second.items()}
            own, theirs = (torch.where(row["episode_start"], 0.0, now) for now in (own, theirs))
            seen, coming = row["observation"][None], row["next_observation"][None]
            q_values, own = network.remember(seen, own)
            theirs = target.remember(seen, theirs)[1]
            values[game, step] = q_values[0, row["action"]]
            following = target.remember(coming, theirs)[0].detach()
            chooser = network.remember(coming, own)[0] if double else following
            best = float(following[0, chooser.argmax()])
            after.append(0.0 if row["terminated"] else best)
        for step in range(9):
            total, discount = 0.0, 1.0
            for later in range(step, min(step + 3, 9)):
                total += discount * float(second["reward"][game, later])
                discount *= 0.9
                ended = bool(second["done"][game, later])
                if ended or later in (step + 2, 8):
                    total += discount * after[later]
                    break
            goals[0, game, step] = total
    error = (values - goals[0]).detach()
    torch.testing.assert_close(ours, error.square().mean(), rtol=1e-4, atol=1e-5)
    expected = 0.9 * error.abs().amax(1) + 0.1 * error.abs().mean(1)
    torch.testing.assert_close(size, expected, rtol=1e-4, atol=1e-5)


# -- what is remembered ----------------------------------------------------------------------------


def test_memories_last_from_rollout_to_rollout_and_end_with_the_episode() -> None:
    env = make_env(8)
    network = make_network(env)
    learner = PPO(PPOSettings(8, rollout_steps=5, minibatch_size=40), env, network, "cpu")
    state, fresh, begun = torch.zeros(8, 16), torch.ones(8, dtype=torch.bool), 0
    for _ in range(4):
        assert isinstance(learner.update, TorchUpdate)
        rollout = learner.update.collector.rollout()
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


def test_what_a_cut_off_episode_ends_with_is_valued_by_what_was_remembered() -> None:
    env = make_env(8)
    network = make_network(env, shared=False)
    learner = PPO(PPOSettings(8, rollout_steps=20, minibatch_size=40), env, network, "cpu")
    assert isinstance(learner.update, TorchUpdate)
    learner.update.collector.keep_next = True
    rollout = learner.update.collector.rollout()
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


@pytest.mark.parametrize("kind", GATES)
def test_a_policy_remembers_in_any_batch_what_its_network_did(kind: str) -> None:
    env = make_env(4)
    network = make_network(env, kind)
    policy = Seat(TASK, "chaser").policy(network, greedy=False)
    assert isinstance(policy, RememberingPolicy) and isinstance(policy, MemoryPolicy)
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


def test_what_remembers_is_never_called_exact() -> None:
    env = make_env(4)
    contest = GameContest(TASK, "chaser", {"evader": AStarEvader(epsilon=0.5)}, 50)
    assert contest.is_exact
    remembering = Seat(TASK, "chaser").policy(make_network(env))
    score = contest.score("learned", remembering)
    assert not score.exact and score.ci95 > 0.0
    against = GameContest(TASK, "evader", {"chaser": remembering}, 50)
    assert not against.is_exact and against.optimal() is None


# -- learning --------------------------------------------------------------------------------------


def reward_of(learner: Any, env: Cues) -> float:
    """What the last step of an episode is paid on average over some rollouts."""
    update = getattr(learner, "update", learner)
    steps = [update.collector.rollout() for _ in range(4)]
    return sum(float(step["reward"].sum()) for step in steps) / sum(
        int(step["done"].sum()) for step in steps
    )


@pytest.mark.parametrize("recurrent", [None, "gru", pytest.param("lstm", marks=pytest.mark.slow)])
def test_ppo_remembers_a_cue_with_a_memory_alone(recurrent: str | None) -> None:
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


@pytest.mark.parametrize("recurrent", [pytest.param(None, marks=pytest.mark.slow), "gru"])
def test_dqn_remembers_a_cue_with_a_memory_alone(recurrent: str | None) -> None:
    torch.manual_seed(0)
    settings = DQNSettings(
        64, 0.95, recurrent, 1e-2, width=16, learning_starts=500, batch_size=256,
        target_update_interval=10, gradient_steps=4, burn_in=4,
    )  # fmt: skip
    env = Cues(64)
    learner: Any = entry("dqn").build(settings, env, Build(seed=1))  # type: ignore[arg-type]
    for step in range(60):
        learner.iterate(step / 60)
    learner.epsilon = 0.0
    paid = reward_of(learner, env)
    learner.close()
    assert paid > 0.95 if recurrent else paid < 0.6, paid


# -- refusals --------------------------------------------------------------------------------------


def test_who_cannot_remember_says_so() -> None:
    flat: dict[str, Any] = {"recurrent": "gru", "frames": 1000, "maze": "3x3"}
    with pytest.raises(ValueError, match="q_learning learns no memory: take ppo, a2c, reinforce"):
        settings_of(algorithm="q_learning", **flat)
    with pytest.raises(ValueError, match=r"cross_entropy learns no memory: .* frame_stack"):
        settings_of(algorithm="cross_entropy", **flat)
    with pytest.raises(ValueError, match="unknown recurrent 'rnn'; one of gru, lstm"):
        settings_of(**{**flat, "recurrent": "rnn"})
    with pytest.raises(ValueError, match="on an arm, which sees all"):
        settings_of(task="reacher", recurrent="gru", frames=1000)
    assert {name for name, one in ALGORITHMS.items() if one.recurrent} == {
        "ppo", "a2c", "reinforce", "dqn",
    }  # fmt: skip


@pytest.mark.parametrize("encoding", ["index", "positions"])
@pytest.mark.parametrize("remembers", [True, False])
def test_cells_of_mazes_of_another_size_are_refused(encoding: str, remembers: bool) -> None:
    seat = Seat(TASK, "chaser", encoding)
    hidden = Hidden(8, recurrent="gru" if remembers else None)
    policy: Any = seat.policy(ActorCritic(seat.features, seat.num_actions, hidden), greedy=True)
    for maze in ("2x2", "5x5"):  # their cells have numbers that mean others, or none
        simulator = Simulator(make_task("chase", maze=maze), 4, 0)
        with pytest.raises(ValueError, match="in mazes of 9 cells; these have"):
            play(policy, simulator.view("chaser"))
        if not remembers:
            with pytest.raises(ValueError, match="in mazes of 9 cells"):
                policy.distribution(simulator.task, simulator.games, 0)
