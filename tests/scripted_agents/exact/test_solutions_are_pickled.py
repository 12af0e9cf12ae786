"""Solutions go to other processes and into files: they are pickled with what they compute later."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pursuit import load_maze, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    best_response,
    best_team_response,
    solve_chase,
    solve_hidden_chase,
    solve_joint,
)

MAZE = load_maze("3x3")
EVADER = AStarEvader(0.2)
TABLE = EVADER.action_probabilities(MAZE)
TEAM = make_task("chase", maze=MAZE, num_chasers=2)
OTHERS = {"evader": EVADER, "chaser": AStarChaser(0.2)}
SOLUTIONS: dict[str, Callable[[], Any]] = {
    "best_response": lambda: best_response("chaser", MAZE, TABLE, horizon=20),
    "best_response of an evader": lambda: best_response("evader", MAZE, TABLE, horizon=20),
    "best_team_response": lambda: best_team_response(TEAM, "chaser", OTHERS, 20),
    "solve_joint": lambda: solve_joint(TEAM, "chaser_0", OTHERS, 9),
    "solve_chase": lambda: solve_chase(MAZE),
    "solve_hidden_chase": lambda: solve_hidden_chase(MAZE, TABLE, view_radius=1, seconds=1),
}


@pytest.mark.parametrize("name", SOLUTIONS)
def test_a_copy_has_the_same_values(name: str) -> None:
    solution = SOLUTIONS[name]()
    copied = pickle.loads(pickle.dumps(solution))
    compared = 0
    for each in dir(solution):
        value = None if each.startswith("_") else getattr(solution, each)
        if isinstance(value, np.ndarray | int | float):
            assert np.array_equal(getattr(copied, each), value), each
            compared += 1
    assert compared
    if name == "best_response":
        assert 0.0 < copied.captured.mean() < 1.0
