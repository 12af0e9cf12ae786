"""A* search for one shortest path in a maze of any size."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import allocating
from pursuit.maze import Maze, load_maze
from pursuit.rules import UNREACHABLE


@allocating
def search(
    neighbors: Any, rows: Any, columns: Any, start: int, goal: int, distances: Any, parents: Any
) -> bool:
    """A* from `start`; fills the distances (UNREACHABLE before) and the parents on its way.

    With the Manhattan heuristic a step keeps the estimated total length or adds two to it, and the
    estimate never falls. So two stacks hold every open cell: those of the present estimate and
    those of the next. Of equal estimates the latest found goes first. False if there is no path.
    """
    size = neighbors.shape[0]
    closed = np.zeros(size, dtype=np.bool_)
    # Every passage is walked at most once in each direction, and pushes at most one entry.
    entry_cell = np.empty(4 * size + 1, dtype=np.int32)
    entry_below = np.empty(4 * size + 1, dtype=np.int32)
    entry_cell[0] = start
    entry_below[0] = -1
    num_entries, present, following = 1, 0, -1
    distances[start] = 0
    parents[start] = start
    while present >= 0 or following >= 0:
        if present < 0:
            present, following = following, -1
        cell = entry_cell[present]
        present = entry_below[present]
        if closed[cell]:
            continue
        if cell == goal:
            return True
        closed[cell] = True
        remaining = abs(rows[cell] - rows[goal]) + abs(columns[cell] - columns[goal])
        for action in range(4):
            after = neighbors[cell, action]
            if distances[cell] + 1 >= distances[after]:
                continue
            distances[after] = distances[cell] + 1
            parents[after] = cell
            entry_cell[num_entries] = after
            if abs(rows[after] - rows[goal]) + abs(columns[after] - columns[goal]) < remaining:
                entry_below[num_entries] = present
                present = num_entries
            else:
                entry_below[num_entries] = following
                following = num_entries
            num_entries += 1
    return False


def shortest_path(maze: Maze, start: int, goal: int) -> list[int]:
    """The cells of one shortest path from `start` to `goal`, both included.

    A path of k steps has k + 1 cells; k is the breadth-first distance, for the Manhattan distance
    never overestimates. Needs no table: memory grows linearly with the cells. Which of several
    shortest paths is found is fixed, but not by a rule worth relying on.
    Hart, Nilsson and Raphael (1968).

    Raises:
        ValueError: a cell is not in the maze, or no path joins the two.
    """
    maze = load_maze(maze)
    start, goal = maze.check_cell(start), maze.check_cell(goal)
    distances = np.full(maze.num_cells, UNREACHABLE, dtype=np.int32)
    parents = np.empty(maze.num_cells, dtype=np.int32)
    if not search(maze.neighbors, maze.rows, maze.columns, start, goal, distances, parents):
        raise ValueError(
            f"{maze.name}: no path joins the cells {start} and {goal}; choose cells of one part of "
            "the maze, or open a wall between the parts"
        )
    path = [goal]
    while path[-1] != start:
        path.append(int(parents[path[-1]]))
    return path[::-1]
