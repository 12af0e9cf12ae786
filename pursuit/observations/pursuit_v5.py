"""The observations and the order of actions of `pursuit_v5` of PettingZoo's SISL environments."""

from __future__ import annotations

from functools import lru_cache

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled
from pursuit.mazes.maze import Maze
from pursuit.rules.arrays import Array, Ints
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
        rows, columns, blocked = _maps_of(task.mazes, edge)
        shape = (len(games.steps), len(seats), self.obs_range, self.obs_range, 3)
        seen = np.empty(shape, dtype=np.float32)
        state = (games.maze_index, games.positions, games.active, games.roles)
        _draw_windows(*state, seats, rows, columns, blocked, edge, seen)
        return np.moveaxis(seen, -1, 2) if self.channels_first else seen


@lru_cache(maxsize=4)
def _maps_of(
    mazes: tuple[Maze, ...], edge: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """The row and column of each cell, [mazes, cells]; and [mazes, height, width], 1 for blocked
    cells, with `edge` blocked rows and columns on all sides."""
    height = max(maze.height for maze in mazes) + 2 * edge
    width = max(maze.width for maze in mazes) + 2 * edge
    cells = max(maze.num_cells for maze in mazes)
    rows, columns = (np.zeros((len(mazes), cells), dtype=np.intp) for _ in "rc")
    blocked = np.ones((len(mazes), height, width), dtype=np.float32)
    for number, maze in enumerate(mazes):
        rows[number, : maze.num_cells] = maze.rows
        columns[number, : maze.num_cells] = maze.columns
        blocked[number, maze.rows + edge, maze.columns + edge] = 0.0
    return rows, columns, blocked


@compiled
def _draw_windows(
    maze: Ints, position: Ints, active: Ints, role: Ints, seats: Array,
    rows: Array, columns: Array, blocked: Array, edge: int, out: Array,
) -> None:  # fmt: skip
    """Fill `out` [games, seats, rows, columns, 3]."""
    side = 2 * edge + 1
    for game in range(out.shape[0]):
        own = maze[game]
        for place in range(out.shape[1]):
            cell = position[game, seats[place]]
            row, column = rows[own, cell], columns[own, cell]  # of the corner, with the edge
            for i in range(side):
                for j in range(side):
                    out[game, place, i, j, 0] = blocked[own, row + i, column + j]
                    out[game, place, i, j, 1] = out[game, place, i, j, 2] = 0.0
            for agent in range(position.shape[1]):
                if active[game, agent] != 0 and (role[agent] == CHASER or role[agent] == EVADER):
                    other = position[game, agent]
                    i, j = rows[own, other] - row + edge, columns[own, other] - column + edge
                    if 0 <= i < side and 0 <= j < side:
                        out[game, place, i, j, 1 + (role[agent] == EVADER)] += 1.0
