"""The observations and the order of actions of `pursuit_v5` of PettingZoo's SISL environments."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from pursuit.rules.layout import CHASER, EAST, EVADER, NORTH, SOUTH, STAY, WEST
from pursuit.tasks.moments import Before
from pursuit.tasks.task import Task
from pursuit.validation import whole

PURSUIT_V5_ACTIONS = (WEST, EAST, SOUTH, NORTH, STAY)
"""Our action for each of the actions 0 to 4 of `pursuit_v5`: left, right, up, down and stay.

Its "up" raises y. Rows of observations are y, and pictures show y downwards, so "up" is south.
"""


class PursuitV5Observation:
    """The observation of `pursuit_v5`: a window around the agent, with three channels.

    float32 [obs_range, obs_range, 3], rows, columns, channels: 1 for blocked cells and cells
    outside the maze, else 0; the number of chasers in each cell, the agent included; the number of
    free evaders. Nothing is scaled. `pursuit_v5` has no walls between cells, so these are not
    shown; neither are goals and exits.

    Args:
        obs_range: rows and columns of the window, an odd number.
        channels_first: [3, rows, columns] instead, the form that networks take as an image.

    Raises:
        ValueError: an even number; a graph, which has no rows and columns.
    """

    def __init__(self, obs_range: int = 7, channels_first: bool = False) -> None:
        self.obs_range = whole("obs_range", obs_range, 1)
        self.channels_first = channels_first
        if obs_range % 2 == 0:
            raise ValueError(f"obs_range={obs_range}: the agent is in the centre; give an odd one")

    def space(self, task: Task) -> gymnasium.spaces.Box:
        """From 0 to the number of chasers or evaders, the larger of both."""
        for maze in task.mazes:
            if not maze.is_grid:
                raise ValueError(
                    f"observation 'pursuit_v5' shows rows and columns, and {maze.name} is a graph; "
                    "use 'index', 'one_hot', 'positions' or 'cells'"
                )
        sides = (self.obs_range,) * 2
        shape = (3, *sides) if self.channels_first else (*sides, 3)
        most = max(task.num_chasers, task.num_evaders, 1)
        return gymnasium.spaces.Box(0.0, float(most), shape, np.float32)

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> Array:
        """[games, seats, *shape] float32."""
        edge = self.obs_range // 2
        height = max(maze.height for maze in task.mazes) + 2 * edge
        width = max(maze.width for maze in task.mazes) + 2 * edge
        rows, columns = (np.zeros((len(task.mazes), task.max_cells), dtype=int) for _ in "rc")
        blocked = np.ones((len(task.mazes), height, width), dtype=np.float32)
        for number, maze in enumerate(task.mazes):
            rows[number, : maze.num_cells] = maze.rows + edge
            columns[number, : maze.num_cells] = maze.columns + edge
            blocked[number, maze.rows + edge, maze.columns + edge] = 0.0
        which, game = games.maze_index, np.arange(len(games.steps))
        board = np.zeros((len(game), height, width, 3), dtype=np.float32)
        board[..., 0] = blocked[which]
        row = rows[which[:, None], games.positions]
        column = columns[which[:, None], games.positions]
        for seat, role in enumerate(games.roles):
            if role in (CHASER, EVADER):
                channel = 1 + int(role == EVADER)
                board[game, row[:, seat], column[:, seat], channel] += games.active[:, seat]
        around = np.arange(self.obs_range) - edge
        down = row[:, seats, None, None] + around[:, None]
        right = column[:, seats, None, None] + around
        seen: Array = board[game[:, None, None, None], down, right]
        return np.moveaxis(seen, -1, 2) if self.channels_first else seen
