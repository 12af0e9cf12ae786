"""The robber that delays its capture longest, against one cop, by `solve_in_turns`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit import Maze, Task
from scripted_agents import solve_in_turns


class Robber:
    """An evader in games with `move_order="turns"` and `stay_action=True`."""

    roles = ("evader",)

    def __init__(self, task: Task, role: str) -> None:
        self.table = self.action_probabilities(task.mazes[0])

    def act(self, view: Any) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game."""
        cells = view.positions
        return self.table[cells[:, 1], cells[:, 0]].argmax(axis=1).astype(np.int32)

    def action_probabilities(self, maze: Maze, stay_action: bool = True) -> NDArray[np.float64]:
        """[own cell, cop's cell, action], one action of probability 1 each."""
        left = solve_in_turns(maze).times[:, maze.neighbors]  # [cop, own cell, action]
        return np.eye(left.shape[2])[left.argmax(axis=2).T]
