"""Which cells an agent sees, and the codes and planes that encode them.

The kernels take the limited views of a task as two arrays of `pursuit.tasks.visibility.Visibility`.
Both are None if no view is limited: the compiler then removes the checks.

    table    bool, for every pair (own cell, other cell) whether the other is visible; row by row,
             maze after maze, one such part for each kind of view
    begin    [agents + 1, mazes] int64, index in the table of an agent's part for a maze, -1 if it
             sees everything; the last row holds the number of cells of each maze
"""

from __future__ import annotations

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Flags, Ints, Longs
from pursuit.rules.layout import COLLECTED, Games

SEES_ALL = -1
FLOOR, SELF, TEAM, OTHER, GOAL, WALL, UNSEEN, EXIT = range(8)
"""Codes of the "cells" and "walls" grids; in a shared cell the first of self, others,
team, goal, exit is drawn."""
PLANES = (
    "self",
    "team",
    "others",
    "goals",
    "just collected",
    "walkable",
    "wall north",
    "wall south",
    "wall east",
    "wall west",
)
"""The first three follow the codes from SELF on."""
IN_VIEW = "in view"
"""The additional plane of tasks with limited views."""
EXITS = "exits"
"""The last plane of tasks with exits."""
GOALS_PLANE, COLLECTED_PLANE = PLANES.index("goals"), PLANES.index("just collected")
MAZE_PLANES, IN_VIEW_PLANE = PLANES.index("walkable"), len(PLANES)


@inlined
def view_of(begin: Longs | None, games: Games, game: int, agent: int | np.uintp) -> int:
    """The index in the table of the row of an agent's cell; SEES_ALL without a limit."""
    if begin is None:
        return SEES_ALL
    maze = games.maze[game]
    first = begin[agent, maze]
    if first < 0:
        return SEES_ALL
    cells = begin[begin.shape[0] - 1, maze]
    return first + games.position[game, agent] * cells


@inlined
def in_view(table: Flags | None, view: int, cell: int) -> bool:
    """Whether a cell is visible in this view."""
    if table is None:
        return True
    return view < 0 or table[view + cell]


@inlined
def place_in_view(places: Ints, table: Flags | None, view: int, game: int, number: int) -> int:
    """The cell of a goal or exit of `places` [games, any]; -1 if it is gone or out of view."""
    cell: int = places[game, number]
    return cell if cell < 0 or in_view(table, view, cell) else -1


@inlined
def rank_of(places: Ints, table: Flags | None, view: int, game: int, goal: int) -> int:
    """The rank of one of `places` among them sorted by cell; those gone or out of view come
    first."""
    cell, rank = place_in_view(places, table, view, game, goal), 0
    for other in range(places.shape[1]):
        other_cell = place_in_view(places, table, view, game, other)
        if other_cell < cell or (other_cell == cell and other < goal):
            rank += 1
    return rank


@inlined
def has_collected(games: Games, game: int, agent: int | np.uintp) -> bool:
    """Whether an agent collected a goal in the last step."""
    return (games.event[game, agent] & COLLECTED) != 0
