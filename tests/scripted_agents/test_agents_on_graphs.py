"""Scripted agents and exact solvers on graphs, against mazes, networkx and plain recursions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import networkx
import numpy as np
import pytest
from numpy.typing import NDArray

import pursuit
from pursuit.mazes.maze import Maze
from pursuit.tasks.task import Task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    TablePolicy,
    best_response,
    best_team_response,
    cop_number,
    evaluate_exactly,
    expected_tour_length,
    shortest_path,
    solve_chase,
    solve_hidden_chase,
    tour_length,
)


def directed(seed: int, size: int = 7) -> Maze:
    """A random strongly connected graph with one-way edges."""
    random = np.random.default_rng(seed)
    graph: Any = networkx.DiGraph(networkx.cycle_graph(size, create_using=networkx.DiGraph))
    for _ in range(size):
        a, b = random.choice(size, 2, replace=False).tolist()
        graph.add_edge(a, b)
    return Maze.from_graph(graph)


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
def test_a_maze_and_its_graph_have_equal_values_bit_for_bit(stay: bool, order: Any) -> None:
    maze = pursuit.load_maze("5x5")
    both = maze, Maze.from_graph(maze.to_graph())
    evader, other = (AStarEvader(0.2).action_probabilities(each, stay) for each in both)
    np.testing.assert_array_equal(evader, other)
    chaser, other = (AStarChaser(0.2).action_probabilities(each, stay) for each in both)
    np.testing.assert_array_equal(chaser, other)
    for role, table in (("chaser", evader), ("evader", chaser)):
        found = [best_response(role, each, table, move_order=order) for each in both]  # type: ignore[arg-type]
        np.testing.assert_array_equal(found[0].values, found[1].values)
        np.testing.assert_array_equal(found[0].policy, found[1].policy)
    one, two = (evaluate_exactly(each, chaser, evader, 50, move_order=order) for each in both)
    np.testing.assert_array_equal(one, two)
    game = [solve_chase(each, stay_action=stay, move_order=order) for each in both]
    np.testing.assert_array_equal(game[0].values, game[1].values)


def test_bounds_under_a_limited_view_are_those_of_the_maze() -> None:
    maze = pursuit.load_maze("3x3")
    table = AStarEvader(0.2).action_probabilities(maze)
    found = [
        solve_hidden_chase(each, table, view_radius=1, seconds=2.0)
        for each in (maze, Maze.from_graph(maze.to_graph()))
    ]
    assert found[0].lower == pytest.approx(found[1].lower, abs=1e-6)
    assert found[0].lower == pytest.approx(4.7048, abs=1e-3)


def test_cop_numbers_of_known_graphs() -> None:
    """Nowakowski and Winkler (1983), Aigner and Fromme (1984)."""
    known = (
        (networkx.petersen_graph(), 3),
        (networkx.dodecahedral_graph(), 3),
        (networkx.balanced_tree(2, 3), 1),
        (networkx.cycle_graph(7), 2),
        (networkx.complete_graph(5), 1),
        (networkx.grid_2d_graph(4, 4, periodic=True), 3),
    )
    for graph, cops in known:
        assert cop_number(Maze.from_graph(graph)) == cops
    maze = pursuit.load_maze("4x4")
    assert cop_number(maze) == cop_number(Maze.from_graph(maze.to_graph()))


def plain_response(
    maze: Maze, role: str, table: NDArray[np.float64], horizon: int, order: str
) -> NDArray[np.float64]:
    """Backward induction written from the rules: [chaser cell, evader cell]."""
    size, moves = maze.num_cells, maze.neighbors.tolist()
    values = np.zeros((size, size))
    for _ in range(horizon):
        new = np.zeros((size, size))
        for chaser in range(size):
            for evader in range(size):
                if chaser == evader:
                    continue
                own, other = (chaser, evader) if role == "chaser" else (evader, chaser)
                options = []
                for mine in moves[own][: table.shape[2]]:
                    total = 1.0
                    for action in range(table.shape[2]):
                        theirs = moves[other][action]
                        c, e = (mine, theirs) if role == "chaser" else (theirs, mine)
                        swapped = c == evader and e == chaser
                        reached = order == "chasers_first" and c == evader
                        if not (c == e or swapped or reached):
                            total += table[other, own, action] * values[c, e]
                    options.append(total)
                new[chaser, evader] = min(options) if role == "chaser" else max(options)
        values = new
    return values


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("seed", range(4))
def test_best_responses_on_directed_graphs(seed: int, order: Any) -> None:
    maze, random = directed(seed), np.random.default_rng(seed)
    assert maze.is_directed
    shape = (maze.num_cells, maze.num_cells, maze.num_moves + seed % 2)
    tables = random.dirichlet(np.ones(shape[2]), size=shape[:2]), None
    for role in ("chaser", "evader"):
        found = best_response(role, maze, tables[0], horizon=12, move_order=order)  # type: ignore[arg-type]
        known = plain_response(maze, role, tables[0], 12, order)
        np.testing.assert_allclose(found.values, known, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_star_measures_paths_along_one_way_edges(seed: int) -> None:
    maze = directed(seed, 9)
    away = maze.distances
    chaser = AStarChaser().action_probabilities(maze)
    evader = AStarEvader(alert_distance=3, look_radius=2).action_probabilities(maze, True)
    for own in range(maze.num_cells):
        for other in range(maze.num_cells):
            if own == other:
                continue
            moves = maze.neighbors[own, :-1]
            nearer = (away[moves, other] == away[own, other] - 1) & (moves != own)
            np.testing.assert_allclose(chaser[own, other], nearer / nearer.sum())
            if away[other, own] >= 3:  # how soon the chaser can come, not the way back
                continue
            reach = np.flatnonzero(away[own] <= 2)
            farthest = away[other, reach].max()
            if farthest == away[other, own]:
                assert evader[own, other, -1] == 1.0
                continue
            aims = reach[away[other, reach] == farthest]
            first = {
                action
                for action, there in enumerate(moves.tolist())
                for aim in aims.tolist()
                if there != own and away[there, aim] == away[own, aim] - 1
            }
            assert set(np.flatnonzero(evader[own, other]).tolist()) == first


@pytest.mark.parametrize(("chasers", "evaders"), [(1, 1), (6, 12)])
def test_scripted_games_on_a_directed_graph_follow_the_tables(chasers: int, evaders: int) -> None:
    """Few agents use tables of distances, many a search, which must go along the edges."""
    maze = directed(1, 30)
    task = Task(maze=maze, num_chasers=chasers, num_evaders=evaders, max_steps=5)
    sim = pursuit.Simulator(task, num_games=64, seed=0)
    sim.reset()
    before, active = sim.positions.copy(), sim.active[:, chasers:].copy() > 0
    policy = AStarChaser()
    for seat in range(chasers):
        actions = policy.act(sim.view(seat))
        after = maze.neighbors[before[:, seat], actions]
        targets = before[:, chasers:]
        far = np.where(active, maze.distances[before[:, seat][:, None], targets], 10**6)
        nearest = far.min(axis=1)
        left = np.where(active, maze.distances[after[:, None], targets], 10**6).min(axis=1)
        np.testing.assert_array_equal(left, nearest - 1)


def test_tours_in_a_directed_graph() -> None:
    maze, random = directed(5, 8), np.random.default_rng(0)
    away = maze.distances
    for _ in range(20):
        start, *goals = random.choice(maze.num_cells, 4, replace=False).tolist()
        known = min(
            away[start, a] + away[a, b] + away[b, c]
            for a in goals
            for b in goals
            for c in goals
            if len({a, b, c}) == 3
        )
        assert tour_length(maze, start, goals) == known
        path = shortest_path(maze, start, goals[0])
        assert len(path) - 1 == away[start, goals[0]]
        assert all(b in maze.neighbors[a] for a, b in pairwise(path))
    mean = expected_tour_length(maze, 1, samples=20_000)
    apart = ~np.eye(maze.num_cells, dtype=bool)
    assert not mean.exact and abs(mean - away[apart].mean()) < 3 * mean.ci95


def test_the_tour_runner_collects_goals_of_a_directed_graph_in_the_shortest_time() -> None:
    from scripted_agents import TourRunner

    maze = directed(5, 10)
    task = Task(maze=maze, num_runners=1, num_goals=3, max_steps=60)
    sim = pursuit.Simulator(task, num_games=100, seed=1, auto_restart=False)
    sim.reset()
    starts, goals = sim.positions[:, 0].copy(), sim.goals.copy()
    lengths, runner = np.zeros(100, dtype=int), TourRunner()
    for step in range(1, 61):
        sim.step(runner.act(sim.view(0))[:, None])
        lengths[(lengths == 0) & sim.terminated] = step
    known = [tour_length(maze, s, g.tolist()) for s, g in zip(starts, goals, strict=True)]
    np.testing.assert_array_equal(lengths, known)


@pytest.mark.parametrize("kind", ["eight", "roads", "geometric"])
def test_simulated_games_have_the_exact_length(kind: str) -> None:
    maze = pursuit.generate_graph(kind, 4, 4, seed=1)
    tables = (
        AStarChaser(0.3).action_probabilities(maze),
        AStarEvader(0.2).action_probabilities(maze),
    )
    exact = evaluate_exactly(maze, *tables, horizon=40)
    task = Task(maze=maze, num_chasers=1, num_evaders=1, max_steps=40)
    sim = pursuit.Simulator(task, num_games=20_000, seed=3, auto_restart=False)
    sim.reset()
    policies, lengths = (AStarChaser(0.3), TablePolicy(maze, tables[1])), np.zeros(20_000)
    for step in range(1, 41):
        actions = [policy.act(sim.view(seat)) for seat, policy in enumerate(policies)]
        sim.step(np.stack(actions, axis=1))
        lengths[(lengths == 0) & (sim.terminated | sim.truncated)] = step
    apart = ~np.eye(maze.num_cells, dtype=bool)
    error = lengths.std() / len(lengths) ** 0.5
    assert abs(lengths.mean() - exact[apart].mean()) < 4 * error
    team = best_team_response(task, "chaser", {"evader": AStarEvader(0.2)}, horizon=40)
    alone = best_response("chaser", maze, tables[1], horizon=40).values
    assert team.mean_over_starts == pytest.approx(alone[apart].mean(), abs=1e-9)
