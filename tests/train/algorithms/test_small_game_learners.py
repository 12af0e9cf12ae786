"""Every learner in small games: illegal actions, turns, three players, general sum."""

from __future__ import annotations

import csv
import math
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_games import Nim

import train
from scripted_agents.games import respond, returns_of
from scripted_agents.games.agents import uniform_table
from train.algorithms.q_learning import QLearning
from train.algorithms.registry import ALGORITHMS
from train.algorithms.regularized import divergence
from train.kinds import start
from train.networks.distributions import Categorical
from train.self_play.parts import self_play_settings_of

MASKED = "small_games:RandomGame(seed=3)"
THREE = "small_games:RandomGame(players=3,seed=5)"
NIM = "small_games:Nim"
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "general sum": (MASKED, {}),
    "three players": (THREE, {"observation": "one_hot", "min_probability": 0.01}),
    "turns": (NIM, {"observation": "observe", "precision": "bfloat16"}),
}
SIZES: dict[str, dict[str, Any]] = {
    "ppo": {"rollout_steps": 8, "minibatch_size": 128},
    "ippo": {"rollout_steps": 8, "minibatch_size": 128},
    "mappo": {"rollout_steps": 8, "minibatch_size": 128},
    "a2c": {"rollout_steps": 8},
    "mmd": {"rollout_steps": 8, "minibatch_size": 128},
    "rnad": {"rollout_steps": 8, "minibatch_size": 128},
    "dqn": {"learning_starts": 256, "batch_size": 64},
    "nfsp": {"learning_starts": 256, "batch_size": 64},
    "cross_entropy": {"population": 32},
    "command_games:LEARNER": {"rollout_steps": 8},
}
OF_TEAMS = [name for name, algorithm in ALGORITHMS.items() if algorithm.whole_role]
ALONE = [
    name
    for name, algorithm in ALGORITHMS.items()
    if "discrete" in algorithm.actions
    and not algorithm.settings.SELF_PLAY_ONLY
    and not algorithm.own_loop
    and name not in (*OF_TEAMS, "tracked")
]
TOGETHER = [n for n, a in ALGORITHMS.items() if a.self_play and n not in OF_TEAMS]


def settings(algorithm: str, **given: Any) -> dict[str, Any]:
    own = SIZES.get(algorithm, {})
    network = {} if algorithm == "q_learning" else {"width": 16}
    size = {"num_games": 32, "max_steps": 20, "threads": 1, "frames": 4000}
    return {"algorithm": algorithm, **size, **network, **own, **given}


def check_metrics(folder: Path) -> None:
    """All losses and scores of a run are finite."""
    with open(folder / "metrics.csv") as file:
        rows = list(csv.DictReader(file))
    assert rows
    for row in rows:
        assert all(math.isfinite(float(value)) for value in row.values() if value), row


@pytest.mark.parametrize("algorithm", OF_TEAMS)
def test_algorithms_of_teams_are_refused(algorithm: str) -> None:
    for make in (train.settings_of, self_play_settings_of):
        with pytest.raises(ValueError, match=r"trains teams, .*; use (ppo|dqn)"):
            make(**settings(algorithm, game=MASKED))


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize("algorithm", [*ALONE, "command_games:LEARNER"])
def test_a_single_learner_plays_legal_actions_and_better_than_at_random(
    algorithm: str, tmp_path: Path
) -> None:
    """`RandomGame` has two players with unrelated rewards, and other legal actions everywhere."""
    flat = settings(algorithm, game=MASKED, player="p1")
    run = start("single", train.settings_of(**flat), tmp_path / "run")
    run.train()
    policy = train.load_policy(tmp_path / "run")
    game = policy.task.game
    tables = {name: uniform_table(game, name) for name in game.players}
    uniform = (game.start @ returns_of(game, tables, 1.0, 20))[1]
    table = policy.table(policy.task)  # only of legal actions
    np.testing.assert_allclose(np.add.reduceat(table, game.offsets(1)[:-1]), 1.0, atol=1e-6)
    learned = (game.start @ returns_of(game, {**tables, "p1": table}, 1.0, 20))[1]
    best = respond(game, "p1", tables, 1.0, 20).mean
    assert uniform + 0.3 * (best - uniform) < learned <= best + 1e-9
    check_metrics(tmp_path / "run")


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize(
    ("algorithm", "kind"), zip([*TOGETHER, "command_games:LEARNER"], cycle(KINDS))
)
def test_all_players_learn_together(algorithm: str, kind: str, tmp_path: Path) -> None:
    game, changed = KINDS[kind]
    flat = settings(algorithm, game=game, snapshots=2, **changed)
    run = start("self-play", self_play_settings_of(**flat), tmp_path / "run")
    run.train()
    tables = {}
    for name in run.trainee.game.task.agent_names:
        policy = train.load_policy(tmp_path / "run" / name)
        task, tables[name] = policy.task, policy.table(policy.task)
        offsets = task.game.offsets(task.seat(name))
        np.testing.assert_allclose(np.add.reduceat(tables[name], offsets[:-1]), 1.0, atol=1e-6)
    assert np.isfinite(returns_of(task.game, tables)).all()
    check_metrics(tmp_path / "run")


# -- tabular Q-learning --------------------------------------------------------------------------


def test_the_table_holds_the_values_of_the_game(tmp_path: Path) -> None:
    """Against a player that takes one, a heap is a shortest path: values by recursion."""
    flat = settings("q_learning", game=NIM, gamma=0.9, learning_rate_power=0.0)
    flat |= {"epsilon_start": 1.0, "epsilon_end": 1.0, "opponent": "command_games:one"}
    run = start("single", train.settings_of(**{**flat, "frames": 20_000}), tmp_path / "run")
    run.train()
    learner = run.trainee.learner
    assert isinstance(learner, QLearning)
    game, states = Nim(), run.trainee.contest.task.game

    def of_action(heap: int, action: int) -> float:
        if heap == action:
            return 1.0
        if heap - action == 1:
            return -0.9  # the other takes the last one
        left = heap - action - 1
        return 0.81 * max(of_action(left, more) for more in game.legal_actions((left, 0), 0))

    visited = 0
    for number, (heap, mover) in enumerate(states.states):
        if mover == 0:
            for action in game.legal_actions((heap, 0), 0):
                place = states.action_lists[0].index(action)
                if learner.visits[number, place]:
                    visited += 1
                    assert learner.q_values[number, place] == pytest.approx(of_action(heap, action))
    assert visited == sum(min(3, heap) for heap in (8, 7, 6, 5, 4, 3, 2, 1))
    illegal = ~run.trainee.parts.seat.legal
    assert not learner.visits[illegal].any()
    loaded = train.load_policy(tmp_path / "run")
    np.testing.assert_array_equal(loaded.q_values, learner.q_values)
    simulator = run.trainee.contest.starts()
    chosen = loaded.act(simulator.view("first"))
    assert run.trainee.parts.seat.legal[simulator.state, chosen].all()
    with pytest.raises(ValueError, match="was trained in game"):
        other = train.settings_of(**{**flat, "game": "small_games:Nim(heap=9)"})
        loaded.table(start("single", other, tmp_path / "other").trainee.contest.task)


# -- masked log-probabilities --------------------------------------------------------------------


def test_divergences_are_those_of_the_legal_actions() -> None:
    """Value and gradient equal those without the illegal actions, and nothing is NaN."""
    random = torch.Generator().manual_seed(0)
    for legal in ([0, 2], [1], [0, 1, 2, 3]):
        mask = torch.zeros(4, dtype=torch.bool)
        mask[legal] = True
        logits, other = (10.0 * torch.randn(4, generator=random) for _ in range(2))
        whole, part = logits.clone().requires_grad_(), logits[legal].clone().requires_grad_()
        policy = Categorical(whole, mask)
        found = divergence(policy, Categorical(other, mask).parameters) + policy.entropy()
        p, q = part.softmax(0), other[legal].softmax(0)
        expected = (p * (p / q).log()).sum() - (p * p.log()).sum()
        found.backward()
        expected.backward()
        assert found.item() == pytest.approx(expected.item(), rel=1e-4, abs=1e-5)
        assert whole.grad is not None and part.grad is not None
        torch.testing.assert_close(whole.grad[legal], part.grad, rtol=1e-3, atol=1e-4)
        assert (whole.grad[~mask] == 0.0).all()
