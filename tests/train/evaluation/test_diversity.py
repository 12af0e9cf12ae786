"""Measures of diversity against brute force: simulated visits, loops over states and triples."""

from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules import captured
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    RandomAgent,
    TablePolicy,
    evaluate_exactly,
    mean_over_starts,
)
from train.evaluation.diversity import (
    cyclic_share,
    describe_diversity,
    diversity,
    diversity_of,
    effective_number,
    mean_distance,
    spread,
    visited_states,
)
from train.evaluation.self_play_text import describe_exploitability

MAZE = load_maze("3x3")


def random_tables(count: int, actions: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return rng.dirichlet(np.full(actions, 0.3), size=(count, MAZE.num_cells, MAZE.num_cells))


def plain_visits(
    maze: Maze, chaser: Any, evader: Any, discount: float, order: str
) -> NDArray[np.float64]:
    """The distribution of states step by step, with loops."""
    now = 1.0 - np.eye(maze.num_cells)
    total = np.zeros_like(now)
    for step in range(120):
        total += discount**step * now
        after = np.zeros_like(now)
        for c, e in np.argwhere(now > 0.0):
            for a, p in enumerate(chaser[c, e]):
                for b, q in enumerate(evader[e, c]):
                    mine, theirs = maze.neighbors[c, a], maze.neighbors[e, b]
                    if not captured(order == "chasers_first", c, mine, e, theirs):
                        after[mine, theirs] += p * q * now[c, e]
        now = after
    return total / total.sum()


@pytest.mark.parametrize(("order", "actions"), [("simultaneous", 4), ("chasers_first", 5)])
def test_visited_states(order: Any, actions: int) -> None:
    chaser, evader = random_tables(2, actions, 0)
    found = visited_states(MAZE, chaser, evader, 0.8, order)
    np.testing.assert_allclose(found, plain_visits(MAZE, chaser, evader, 0.8, order), atol=1e-9)
    # The mean number of discounted steps is the number of visits of a game.
    steps = mean_over_starts(evaluate_exactly(MAZE, chaser, evader, None, 0.8, order), MAZE)
    start = 1.0 / (MAZE.num_cells * (MAZE.num_cells - 1))
    unvisited = visited_states(MAZE, chaser, evader, 1e-12, order)
    np.testing.assert_allclose(unvisited[~np.eye(9, dtype=bool)], start, atol=1e-9)
    assert (found * steps >= start - 1e-9)[~np.eye(9, dtype=bool)].all()


def test_mean_distance_against_loops() -> None:
    tables = random_tables(3, 5, 1)
    visits = np.random.default_rng(2).dirichlet(np.ones(81), size=3).reshape(3, 9, 9)
    total = 0.0
    for i, k in [(0, 1), (0, 2), (1, 2)]:
        for own in range(9):
            for other in range(9):
                apart = 0.0
                for cell in range(9):
                    there = MAZE.neighbors[own] == cell
                    gap = tables[i, own, other][there].sum() - tables[k, own, other][there].sum()
                    apart += 0.5 * abs(gap)
                total += 0.5 * (visits[i, own, other] + visits[k, own, other]) * apart
    assert mean_distance(MAZE, tables, visits) == pytest.approx(total / 3)
    assert mean_distance(MAZE, tables[:1], visits[:1]) == 0.0


def test_moves_into_walls_are_one_action() -> None:
    """In the corner cell 0, north and west both stay: policies that differ there are the same."""
    north, west = (np.broadcast_to(np.eye(4)[action], (9, 9, 4)) for action in (0, 3))
    visits = np.zeros((2, 9, 9))
    visits[:, 0, 5] = 1.0
    assert mean_distance(MAZE, np.stack([north, west]), visits) == 0.0
    visits[:, 0, 5], visits[:, 4, 5] = 0.25, 0.75
    away = MAZE.neighbors[4, 0] != MAZE.neighbors[4, 3]
    assert mean_distance(MAZE, np.stack([north, west]), visits) == pytest.approx(0.75 * away)


def test_effective_number() -> None:
    assert effective_number(np.array([1.0, 0.0])) == 1.0
    assert effective_number(np.full(4, 0.25)) == pytest.approx(4.0)
    assert effective_number(np.array([0.5, 0.25, 0.25])) == pytest.approx(2.0**1.5)


@pytest.mark.parametrize("seed", range(5))
def test_cyclic_share_against_all_triples(seed: int) -> None:
    results = np.random.default_rng(seed).integers(4, size=(6, 3)).astype(float)

    def better(a: int, b: int) -> bool:
        return int((results[a] > results[b]).sum()) > int((results[a] < results[b]).sum())

    cyclic = sum(
        better(a, b) and better(b, c) and better(c, a) for a, b, c in permutations(range(6), 3)
    )
    assert cyclic_share(results) == pytest.approx(cyclic / 3 / 20)


def test_cycles_of_known_results() -> None:
    """Each of three players is better than the next against two of three opponents (Condorcet)."""
    assert cyclic_share(np.array([[3.0, 1.0, 2.0], [2.0, 3.0, 1.0], [1.0, 2.0, 3.0]])) == 1.0
    assert cyclic_share(np.arange(12.0).reshape(4, 3)) == 0.0
    assert cyclic_share(np.ones((3, 2))) == 0.0
    assert cyclic_share(np.ones((2, 2))) is None


def test_copies_have_no_diversity() -> None:
    chasers = np.stack([AStarChaser(0.2).action_probabilities(MAZE)] * 3)
    evaders = np.stack([AStarEvader(0.2).action_probabilities(MAZE)] * 4)
    found = diversity(MAZE, chasers, evaders, 0.95, "simultaneous")
    for role, count in (("chaser", 3), ("evader", 4)):
        assert list(found[role].values()) == [count, 0.0, 1.0, 0.0]
    other = RandomAgent().action_probabilities(MAZE)
    found = diversity(MAZE, np.stack([chasers[0], other]), evaders, 0.95, "simultaneous")
    assert 0.1 < (found["chaser"]["distance"] or 0.0) < 1.0
    assert found["chaser"]["effective_number"] == 1.0  # A* is always better
    assert found["chaser"]["cycles"] is None and found["evader"]["distance"] == 0.0


def test_diversity_of_members() -> None:
    task = make_task("chase", maze="3x3")
    members = [
        SimpleNamespace(name=str(number), policy=TablePolicy(MAZE, table))
        for number, table in enumerate(random_tables(12, 4, 3))
    ]
    assert [one.name for one in spread(members, 3)] == ["0", "5", "11"]  # type: ignore[arg-type]
    kept: Any = {"chaser": members, "evader": members[:3]}
    found = diversity_of(task, 0.9, kept)
    assert found["chaser"]["snapshots"] == 8 and found["evader"]["snapshots"] == 3
    text = describe_diversity(found)
    assert text.startswith("Diversity of snapshots: chaser mean distance 0.")
    assert " of 8, " in text and "% of triples cyclic" in text
    assert diversity_of(task, 0.9, {"chaser": members}) == {}  # type: ignore[dict-item]
    assert diversity_of(task, 0.9, {"chaser": members, "evader": members[:1]}) == {}  # type: ignore[dict-item]
    two = make_task("chase", maze="3x3", num_chasers=2)
    assert diversity_of(two, 0.9, kept) == {}


def test_sentence_of_the_report() -> None:
    one = {"snapshots": 8, "distance": 0.1989, "effective_number": 1.5, "cycles": 0.25}
    two = {**one, "snapshots": 2, "cycles": None}
    results = {"evaluation": {}, "frames": 5, "seconds": 1.0}
    assert len(describe_exploitability(results)) == 1
    line = describe_exploitability({**results, "diversity": {"chaser": one, "evader": two}})[0]
    assert line == (
        "Diversity of snapshots: chaser mean distance 0.199, effective number 1.50 of 8, "
        "25 % of triples cyclic; evader mean distance 0.199, effective number 1.50 of 2."
    )
