"""Tasks as small games against the joint solver, and the bridge to OpenSpiel."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import pursuit
from pursuit.rules.layout import empty_games
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, joint_nash_conv, solve_chase, solve_joint_game
from scripted_agents.games import (
    SmallGameEnv,
    enumerate_game,
    equilibrium,
    game_of_task,
    nash_conv,
    respond,
    returns_of,
    states_of_games,
)
from scripted_agents.games.library.soccer import Soccer


def test_a_race_and_a_heist_have_the_values_of_the_joint_solver() -> None:
    for name in ("race", "heist"):
        task = make_task(name, maze="3x3-tree", num_goals=2)
        small = game_of_task(task)
        lead = small.rewards[:, 0] - small.rewards[:, 1]
        zero_sum = type(small)(**{**vars(small), "rewards": np.stack([lead, -lead], axis=1)})
        known = solve_joint_game(task, 0.95)
        assert equilibrium(zero_sum, 0.95).mean == pytest.approx(known.mean_over_starts, abs=1e-9)


def test_drawn_exits_are_part_of_the_states_and_of_the_starts() -> None:
    task = make_task("heist", maze="2x2-tree", num_goals=1, num_exits=1)
    small = game_of_task(task)
    assert len({*small.states}) == small.num_states
    lead = small.rewards[:, 0] - small.rewards[:, 1]
    zero_sum = type(small)(**{**vars(small), "rewards": np.stack([lead, -lead], axis=1)})
    known = solve_joint_game(task, 0.95)
    assert equilibrium(zero_sum, 0.95).mean == pytest.approx(known.mean_over_starts, abs=1e-9)

    # Of 36 placements of exit and agents 12 have the chaser on the exit; goals are placed last.
    on_exit = [cells[0] in exits for cells, _, exits in small.states]
    assert small.start[on_exit].sum() == pytest.approx(12 / 36)
    waiting = {name: lambda state: {0: 1.0} for name in task.agent_names}
    env = SmallGameEnv(small, "evader_0", waiting)
    env.reset(seed=0)
    assert env.recorded is not None
    assert states_of_games(env.recorded.games) == [small.states[env.state]]


def test_a_team_has_the_nash_conv_of_the_joint_solver() -> None:
    task = Task(maze="2x2-tree", num_chasers=2, num_evaders=1, rewards="zero_sum")
    small = game_of_task(task)
    policies = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.4)}
    games = empty_games(small.num_states, 3, 0)
    games.position[:], games.active[:] = [cells for cells, _ in small.states], 1
    tables = {}
    for seat, (name, role) in enumerate(zip(task.agent_names, task.seat_roles, strict=True)):
        rows: list[Any] = []
        chances = policies[role].distribution(task, games, seat)
        for (cells, _), actions, row in zip(
            small.states, small.actions[seat], chances, strict=True
        ):
            # An action that is not listed leads to the same cell as one that is.
            moves = task.mazes[0].neighbors[cells[seat]]
            rows += [
                sum(row[other] for other in range(4) if moves[other] == moves[action])
                for action in actions
            ]
        tables[name] = np.array(rows)
    known = joint_nash_conv(task, policies, horizon=None, discount=0.9)
    found = nash_conv(small, tables, 0.9)
    for name in task.agent_names:
        assert found.returns[name] == pytest.approx(known.returns[name], abs=1e-8)
        assert found.best[name] == pytest.approx(known.best[name], abs=1e-8)
    both = respond(small, ["chaser_0", "chaser_1"], tables, 0.9)
    reached = small.start @ returns_of(small, {**tables, **both.tables}, 0.9)
    assert reached[:2].sum() == pytest.approx(both.mean, abs=1e-8)
    assert both.mean > found.best["chaser_0"] + found.returns["chaser_1"] - 1e-9


def test_own_rewards_and_large_tasks_are_refused() -> None:
    with pytest.raises(ValueError, match="states"):
        game_of_task(make_task("chase", maze="15x15", num_chasers=2))
    with pytest.raises(ValueError, match="custom reward function"):
        game_of_task(
            make_task("chase", maze="2x2", rewards=lambda before, actions, after: after.rewards)
        )


def duel(horizon: int) -> tuple[Any, Any, Any]:
    """A small chase, the same in OpenSpiel, and the module."""
    openspiel = pytest.importorskip("scripted_agents.games.openspiel", exc_type=ImportError)
    task = make_task("chase", maze="2x2-tree", rewards="zero_sum", max_steps=horizon)
    small = game_of_task(task)
    return task, small, openspiel.to_openspiel(small, horizon)


def test_openspiel_plays_the_same_game() -> None:
    _, small, spiel = duel(6)
    random = np.random.default_rng(0)
    for _ in range(50):
        state = spiel.new_initial_state()
        outcomes = state.chance_outcomes()
        assert sum(chance for _, chance in outcomes) == pytest.approx(1.0)
        state.apply_action(int(random.integers(len(outcomes))))
        cells, total = small.states[state.state][0], 0.0
        while not state.is_terminal():
            assert state.is_simultaneous_node()
            actions = [int(random.choice(state.legal_actions(player))) for player in (0, 1)]
            chosen = [small.actions[p][state.state][a] for p, a in enumerate(actions)]
            moves = pursuit.load_maze("2x2-tree").neighbors
            before, cells = (
                cells,
                tuple(int(moves[c, a]) for c, a in zip(cells, chosen, strict=True)),
            )
            state.apply_actions(actions)
            total -= 1.0
            assert state.rewards() == [-1.0, 1.0]
            caught = cells[0] == cells[1] or cells == before[::-1]
            assert state.is_terminal() == (caught or total == -6.0)
            if not state.is_terminal():
                assert small.states[state.state] == (cells, ())
        assert state.returns() == [total, -total]


@pytest.mark.slow
def test_an_equilibrium_of_openspiel_has_the_exact_value() -> None:
    """Counterfactual regret minimisation (Zinkevich et al., 2007) on the game in turns."""
    _, small, _ = duel(2)
    exact = equilibrium(small, 1.0, horizon=2).mean
    maze = pursuit.load_maze("2x2-tree")
    apart = ~np.eye(maze.num_cells, dtype=bool)
    assert exact == pytest.approx(-solve_chase(maze, horizon=2).values[apart].mean(), abs=1e-12)
    # In a process of its own, as the Python part of OpenSpiel closes the streams that pytest reads.
    done = subprocess.run([sys.executable, "-c", CFR], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[-1]) == pytest.approx(exact, abs=0.02)


CFR = """
import pyspiel
from open_spiel.python.algorithms import cfr, expected_game_score
from pursuit.tasks.task import make_task
from scripted_agents.games import game_of_task
from scripted_agents.games.openspiel import to_openspiel

task = make_task("chase", maze="2x2-tree", rewards="zero_sum")
turns = pyspiel.convert_to_turn_based(to_openspiel(game_of_task(task), 2))
solver = cfr.CFRSolver(turns)
for _ in range(40):
    solver.evaluate_and_update_policy()
average = solver.average_policy()
values = expected_game_score.policy_value(turns.new_initial_state(), [average, average])
print(values[0])
"""


def test_a_policy_of_openspiel_plays_in_a_seat() -> None:
    task, small, spiel = duel(5)
    openspiel = pytest.importorskip("scripted_agents.games.openspiel", exc_type=ImportError)

    class First:
        """The first legal action with probability 0.75, the last with the rest."""

        def action_probabilities(self, state: Any, player: int) -> dict[int, float]:
            legal = state.legal_actions(player)
            return {legal[0]: 1.0} if len(legal) == 1 else {legal[0]: 0.75, legal[-1]: 0.25}

    policy = openspiel.OpenSpielPolicy(small, spiel, First())
    sim = Simulator(task, num_games=4000, seed=0)
    sim.reset()
    view = sim.view(1)
    rows = policy.distribution(task, view.games, 1)
    for row, state in zip(rows, states_of_games(view.games), strict=True):
        actions = small.actions[1][small.number[state]]
        assert row[actions[0]] == (1.0 if len(actions) == 1 else 0.75)
    drawn = policy.act(view)
    shares = np.bincount(drawn, minlength=4) / 4000
    np.testing.assert_allclose(shares, rows.mean(axis=0), atol=0.03)


@pytest.mark.slow
def test_soccer_has_the_values_of_openspiels(monkeypatch: pytest.MonkeyPatch) -> None:
    openspiel = pytest.importorskip("scripted_agents.games.openspiel_games", exc_type=ImportError)
    monkeypatch.setattr(openspiel, "CHECKED", 5_000)  # all comparisons take half a minute
    ours, theirs = (
        enumerate_game(Soccer()),
        enumerate_game(openspiel.OpenSpielGame("markov_soccer")),
    )
    values, known = (equilibrium(game, 0.9).values for game in (ours, theirs))
    number = {state[0]: index for index, state in enumerate(theirs.states)}  # type: ignore[index]
    for (a, b, ball), value in zip(ours.states, values, strict=True):  # type: ignore[misc]
        field = [["."] * 5 for _ in range(4)]
        for player, (row, column) in enumerate((a, b)):  # there A attacks east
            field[row][4 - column] = ("AB" if ball == player else "ab")[player]
        text = "".join("".join(row) + "\n" for row in field)
        assert value == pytest.approx(known[number[text]], abs=1e-9)
    assert np.abs(values).max() > 0.8
