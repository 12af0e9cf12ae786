"""Mazes for kernels: several mazes concatenated in four flat arrays."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, table_of_distances
from pursuit.rules import layout
from pursuit.rules.distances import NO_PATH

NO_CELL = -1


class MazeArrays(NamedTuple):
    """The arrays of mazes that kernels use; `layout.world_of` gives names to their parts.

    Attributes:
        mazes: [GOAL_MARKS + marks, num_mazes] int64, the offsets and marks of each maze.
        neighbors: [all cells, moves + 1] int32.
        facts: [FACT_LAYERS, all cells] int32, the row, column, distance to the nearest goal
            mark, and bit mask of moves of every cell.
        tables: uint16, the distance tables of all mazes that have one, flattened.
    """

    mazes: NDArray[np.int64]
    neighbors: NDArray[np.int32]
    facts: NDArray[np.int32]
    tables: NDArray[np.uint16]

    @property
    def world(self) -> layout.World:
        """The same arrays under the names that kernels use."""
        return layout.named_views(layout.world_of, *self)


@lru_cache(maxsize=4)
def grids_of(mazes: tuple[Maze, ...]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Two arrays of the largest height, width and number of cells of `mazes`, none a graph.

    [mazes, height, width] int32, the number of each cell, NO_CELL if there is none; and
    [mazes, cells, 3] int32, row, column, and walls of each cell: bit 1 << action is set if the move
    does not change the cell.
    """
    sides = [max(getattr(maze, side) for maze in mazes) for side in ("height", "width")]
    cells = np.full((len(mazes), *sides), NO_CELL, dtype=np.int32)
    places = np.zeros((len(mazes), max(maze.num_cells for maze in mazes), 3), dtype=np.int32)
    for number, maze in enumerate(mazes):
        own = np.arange(maze.num_cells)
        cells[number, maze.rows, maze.columns] = own
        closed = (maze.neighbors[:, :4] == own[:, None]) @ (1 << np.arange(4))
        places[number, : len(own)] = np.stack([maze.rows, maze.columns, closed], axis=1)
    return cells, places


@lru_cache(maxsize=64)
def lay_out(mazes: tuple[Maze, ...]) -> MazeArrays:
    """The arrays of `mazes`; mazes of more than MAX_TABLE_CELLS cells get no distance table."""
    num_marks = max(len(maze.goal_marks) for maze in mazes)
    num_cells = sum(maze.num_cells for maze in mazes)
    num_distances = sum(maze.num_cells**2 for maze in mazes if maze.num_cells <= MAX_TABLE_CELLS)
    arrays = MazeArrays(
        mazes=np.full((layout.GOAL_MARKS + num_marks, len(mazes)), -1, dtype=np.int64),
        neighbors=np.concatenate([maze.neighbors for maze in mazes]),
        facts=np.zeros((layout.FACT_LAYERS, num_cells), dtype=np.int32),
        tables=np.empty(num_distances, dtype=np.uint16),
    )
    world = arrays.world
    first_cell = first_distance = 0
    for number, maze in enumerate(mazes):
        own = slice(first_cell, first_cell + maze.num_cells)
        world.first_cell[number], world.num_cells[number] = first_cell, maze.num_cells
        if maze.num_cells <= MAX_TABLE_CELLS:
            world.table[number] = first_distance
            distances = maze.distances if len(mazes) == 1 else table_of_distances(maze)
            last_distance = first_distance + maze.num_cells**2
            np.minimum(
                distances.ravel(),
                NO_PATH,
                out=arrays.tables[first_distance:last_distance],
                casting="unsafe",
            )
            first_distance = last_distance
        if maze.start_mark is not None:
            world.start_mark[number] = maze.start_mark
        world.num_goal_marks[number] = len(maze.goal_marks)
        world.goal_marks[: len(maze.goal_marks), number] = maze.goal_marks
        if maze.is_grid:
            world.row[own], world.column[own] = maze.rows, maze.columns
        changes = maze.neighbors[:, :-1] != np.arange(maze.num_cells)[:, None]
        world.moves[own] = changes @ (1 << np.arange(maze.num_moves))
        world.directed[number] = maze.is_directed
        if maze.goal_marks:
            nearest = np.min([maze.distances_from(goal) for goal in maze.goal_marks], axis=0)
            world.mark_distance[own] = nearest
        first_cell += maze.num_cells
    return arrays
