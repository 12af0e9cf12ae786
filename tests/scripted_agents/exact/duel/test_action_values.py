"""What actions are worth agrees with the best response, which is solved by other code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pursuit
from scripted_agents import AStarChaser, AStarEvader, action_values, best_response

ORDERS = ("simultaneous", "chasers_first")


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("horizon", [1, 2, 200])
def test_the_best_action_has_the_value_of_the_best_response(
    role: Any, order: Any, stay: bool, horizon: int
) -> None:
    maze = pursuit.load_maze("5x5")
    other = AStarEvader(0.3) if role == "chaser" else AStarChaser(0.3)
    table = other.action_probabilities(maze, stay_action=stay)
    found = action_values(role, maze, table, horizon, move_order=order)
    best = best_response(role, maze, table, horizon, move_order=order)
    apart = ~np.eye(maze.num_cells, dtype=bool)
    expected = best.values if role == "chaser" else best.values.T
    np.testing.assert_allclose(found.values[apart], expected[apart], rtol=1e-9)
    first = np.take_along_axis(found.optimal, best.actions.astype(int)[:, :, None], axis=2)
    assert first[apart].all() and not found.optimal[~apart].any()


def test_all_ties_are_found() -> None:
    maze = pursuit.Maze.from_text("+-+-+-+\n|     |\n+ + + +\n|     |\n+ + + +\n|     |\n+-+-+-+")
    still = np.zeros((9, 9, 5))
    still[:, :, 4] = 1.0
    found = action_values("chaser", maze, still, stay_action=False)
    # From one corner to the opposite one two moves begin a shortest way.
    assert found.optimal[0, 8].tolist() == [False, True, True, False]
    assert found.values[0, 8] == pytest.approx(4.0)


def test_a_maze_may_be_given_by_its_name() -> None:
    table = AStarEvader(0.2).action_probabilities(pursuit.load_maze("3x3"))
    named = action_values("chaser", "3x3", table)
    np.testing.assert_array_equal(
        named.steps, action_values("chaser", pursuit.load_maze("3x3"), table).steps
    )
