"""Mazes for kernels: several mazes concatenated in four flat arrays."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, table_of_distances
from pursuit.rules.distances import NO_PATH
from pursuit.rules.layout import (
    COLUMN,
    DIRECTED,
    FACT_LAYERS,
    FIRST_CELL,
    GOAL_MARKS,
    MARK_DISTANCE,
    MOVES,
    NUM_CELLS,
    NUM_GOAL_MARKS,
    ROW,
    START_MARK,
    TABLE,
    World,
)

NO_CELL = -1


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
def lay_out(mazes: tuple[Maze, ...]) -> World:
    """The arrays of `mazes`; mazes of more than MAX_TABLE_CELLS cells get no distance table."""
    num_marks = max(len(maze.goal_marks) for maze in mazes)
    num_cells = sum(maze.num_cells for maze in mazes)
    num_distances = sum(maze.num_cells**2 for maze in mazes if maze.num_cells <= MAX_TABLE_CELLS)
    world = World(
        mazes=np.full((GOAL_MARKS + num_marks, len(mazes)), -1, dtype=np.int64),
        neighbors=np.concatenate([maze.neighbors for maze in mazes]),
        facts=np.zeros((FACT_LAYERS, num_cells), dtype=np.int32),
        tables=np.empty(num_distances, dtype=np.uint16),
    )
    first_cell = first_distance = 0
    for number, maze in enumerate(mazes):
        own = slice(first_cell, first_cell + maze.num_cells)
        world.mazes[FIRST_CELL, number], world.mazes[NUM_CELLS, number] = first_cell, maze.num_cells
        if maze.num_cells <= MAX_TABLE_CELLS:
            world.mazes[TABLE, number] = first_distance
            distances = maze.distances if len(mazes) == 1 else table_of_distances(maze)
            last_distance = first_distance + maze.num_cells**2
            np.minimum(
                distances.ravel(),
                NO_PATH,
                out=world.tables[first_distance:last_distance],
                casting="unsafe",
            )
            first_distance = last_distance
        if maze.start_mark is not None:
            world.mazes[START_MARK, number] = maze.start_mark
        world.mazes[NUM_GOAL_MARKS, number] = len(maze.goal_marks)
        world.mazes[GOAL_MARKS : GOAL_MARKS + len(maze.goal_marks), number] = maze.goal_marks
        if maze.is_grid:
            world.facts[ROW, own], world.facts[COLUMN, own] = maze.rows, maze.columns
        changes = maze.neighbors[:, :-1] != np.arange(maze.num_cells)[:, None]
        world.facts[MOVES, own] = changes @ (1 << np.arange(maze.num_moves))
        world.mazes[DIRECTED, number] = maze.is_directed
        if maze.goal_marks:
            nearest = np.min([maze.distances_from(goal) for goal in maze.goal_marks], axis=0)
            world.facts[MARK_DISTANCE, own] = nearest
        first_cell += maze.num_cells
    return world
