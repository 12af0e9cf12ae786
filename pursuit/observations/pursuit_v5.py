"""The observations and the order of actions of `pursuit_v5` of PettingZoo's SISL environments."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled
from pursuit.mazes.maze_arrays import grids_of
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
        flat: [rows * columns * 3] instead, without upper bounds: networks divide by the largest
            value of an observation, and here counts are hardly ever above 2.

    Raises:
        ValueError: an even number; a graph, which has no rows and columns.
    """

    def __init__(
        self, obs_range: int = 7, channels_first: bool = False, flat: bool = False
    ) -> None:
        self.obs_range = whole("obs_range", obs_range, 1)
        self.channels_first, self.flat = channels_first, flat
        if obs_range % 2 == 0:
            raise ValueError(f"obs_range={obs_range}: the agent is in the centre; give an odd one")

    def space(self, task: Task) -> gymnasium.spaces.Box:
        """From 0 to the number of chasers or evaders, the larger of both; `flat`: to infinity."""
        for maze in task.mazes:
            if not maze.is_grid:
                raise ValueError(
                    f"observation 'pursuit_v5' shows rows and columns, and {maze.name} is a graph; "
                    "use 'index', 'one_hot', 'positions' or 'cells'"
                )
        sides = (self.obs_range,) * 2
        shape: tuple[int, ...] = (3, *sides) if self.channels_first else (*sides, 3)
        most: float = max(task.num_chasers, task.num_evaders, 1)
        if self.flat:
            shape, most = (math.prod(shape),), math.inf
        return gymnasium.spaces.Box(0.0, float(most), shape, np.float32)

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> Array:
        """[games, seats, *shape] float32."""
        shape = (len(games.steps), len(seats), self.obs_range, self.obs_range, 3)
        seen = np.empty(shape, dtype=np.float32)
        state = (games.maze_index, games.positions, games.active, games.roles)
        _draw_windows(*state, seats, *grids_of(task.mazes), self.obs_range // 2, seen)
        seen = np.moveaxis(seen, -1, 2) if self.channels_first else seen
        return seen.reshape(*seen.shape[:2], -1) if self.flat else seen


@compiled
def _draw_windows(
    maze: Ints, position: Ints, active: Ints, role: Ints, seats: Array, cells: Ints, places: Ints,
    edge: int, out: Array,
) -> None:  # fmt: skip
    """Fill `out` [games, seats, rows, columns, 3]; `cells` and `places` are of `grids_of`."""
    side = 2 * edge + 1
    for game in range(out.shape[0]):
        own = maze[game]
        for place in range(out.shape[1]):
            cell = position[game, seats[place]]
            top, left = places[own, cell, 0] - edge, places[own, cell, 1] - edge
            for i in range(side):
                for j in range(side):
                    row, column = top + i, left + j
                    inside = 0 <= row < cells.shape[1] and 0 <= column < cells.shape[2]
                    is_cell = inside and cells[own, row, column] >= 0
                    out[game, place, i, j, 0] = 0.0 if is_cell else 1.0
                    out[game, place, i, j, 1] = out[game, place, i, j, 2] = 0.0
            for agent in range(position.shape[1]):
                if active[game, agent] != 0 and (role[agent] == CHASER or role[agent] == EVADER):
                    other = position[game, agent]
                    i, j = places[own, other, 0] - top, places[own, other, 1] - left
                    if 0 <= i < side and 0 <= j < side:
                        out[game, place, i, j, 1 + (role[agent] == EVADER)] += 1.0
