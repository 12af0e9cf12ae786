"""Scripted agents under options of the rules, against their definitions in plain Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pursuit.mazes.generation import generate_graph, generate_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser, AStarEvader

LOOPS = generate_maze("prim", 5, loops=0.5, seed=1)
TORUS = generate_graph("torus", 4, 4)


def first_steps(maze: Any, own: int, target: int) -> set[int]:
    """The moves that begin a shortest path."""
    away = maze.distances[own, target]
    moves = maze.neighbors[own, : maze.num_moves].tolist()
    return {move for move, cell in enumerate(moves) if maze.distances[cell, target] == away - 1}


@pytest.mark.parametrize("maze", [LOOPS, TORUS], ids=str)
def test_evaders_head_for_the_nearest_exit_that_they_reach_first(maze: Any) -> None:
    task = Task(maze, 2, 1, num_exits=3, stay_action=True)
    simulator, actions = Simulator(task, 500, seed=1), np.zeros((500, 3), dtype=np.int32)
    simulator.act([AStarChaser(), AStarChaser(), AStarEvader()], actions)
    away, compared = maze.distances, 0
    for game in range(500):
        *chasers, own = simulator.positions[game].tolist()
        exits = simulator.exits[game].tolist()
        open_ = [e for e in exits if away[own, e] < min(away[c, e] for c in chasers)]
        if open_:
            least = min(away[own, e] for e in open_)
            right = [first_steps(maze, own, e) for e in open_ if away[own, e] == least]
            assert actions[game, 2] in set().union(*right)
            compared += 1
    assert 100 < compared < 500


@pytest.mark.parametrize("maze", [LOOPS, TORUS], ids=str)
def test_chasers_head_for_their_own_cells_around_the_evader(maze: Any) -> None:
    """Pairs of a chaser and a free cell next to the evader are assigned in the order of their
    distances."""
    task = Task(maze, 3, 1, capture="surround", stay_action=True)
    simulator, actions = Simulator(task, 300, seed=2), np.zeros((300, 4), dtype=np.int32)
    simulator.act([AStarChaser(), AStarChaser(), AStarChaser(), AStarEvader()], actions)
    for game in range(300):
        *chasers, evader = simulator.positions[game].tolist()
        moves = maze.neighbors[evader, : maze.num_moves].tolist()
        cells = list(dict.fromkeys(cell for cell in moves if cell != evader))
        pairs = sorted(
            (maze.distances[own, cell], seat, moves.index(cell), cell)
            for seat, own in enumerate(chasers)
            for cell in cells
        )
        target: dict[int, int] = {}
        for _, seat, _, cell in pairs:
            if seat not in target and cell not in target.values():
                target[seat] = cell
        for seat, own in enumerate(chasers):
            aim = target.get(seat, evader)
            expected = {maze.num_moves} if own == aim else first_steps(maze, own, aim)
            assert actions[game, seat] in expected
