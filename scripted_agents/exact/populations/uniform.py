"""The first policy of the population methods for duels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.validation import check_bool, number


def uniform_duel_table(maze: Maze, discount: float, stay_action: bool) -> NDArray[np.float64]:
    """[own cell, other cell, action] float64: uniformly random actions.

    Raises:
        ValueError: a discount outside (0, 1), or a `stay_action` that is not a bool.
    """
    if not 0.0 < number("discount", discount) < 1.0:
        raise ValueError(f"discount={discount}; give a number in (0, 1)")
    actions = maze.num_moves + check_bool("stay_action", stay_action)
    return np.full((maze.num_cells, maze.num_cells, actions), 1.0 / actions)
