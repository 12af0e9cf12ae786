"""The encoding "window": what lies around an agent, the same for mazes of any size."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.compiled import compiled
from pursuit.own_observations import given_radius
from pursuit.rules.layout import Games
from pursuit.rules.sight import (
    COLLECTED_PLANE,
    GOALS_PLANE,
    IN_VIEW,
    IN_VIEW_PLANE,
    MAZE_PLANES,
    PLANES,
    SELF,
    code_of,
    goal_in_view,
    has_collected,
    in_view,
    view_of,
)
from pursuit.task import Task

NO_CELL = -1


def planes_of(task: Task) -> tuple[str, ...]:
    """The names of the planes of "planes" and "window": one more where sight is limited."""
    return (*PLANES, IN_VIEW) if task.sight.limited else PLANES


def radius_of(task: Task, encoding: str) -> int:
    """R, of a window of 2R + 1 rows and columns.

    It is that of "window:R"; of "window" alone the largest view radius of the task, and where there
    is none the smallest that shows the whole of every maze from each of its cells.

    Raises:
        ValueError: an R that is none.
    """
    given = given_radius(encoding)
    if given is not None:
        return given
    radii = [limit.view_radius for limit in task.sight.limits if limit.view_radius is not None]
    if radii:
        return given_radius(f"window:{max(radii)}") or 0
    return max(max(maze.height, maze.width) for maze in task.mazes) - 1


class Grids(NamedTuple):
    """Mazes as grids.

    Attributes:
        cells: [mazes, height, width] int32, the number of each cell, NO_CELL where none is.
        rows, columns: [mazes, cells] int32, where each cell lies.
        walls: [mazes, cells] uint8, the bit 1 << action where a move does not change the cell.
    """

    cells: NDArray[np.int32]
    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    walls: NDArray[np.uint8]


def grids_of(task: Task) -> Grids:
    """The mazes of a task."""
    count, size = len(task.mazes), task.max_cells
    height = max(maze.height for maze in task.mazes)
    width = max(maze.width for maze in task.mazes)
    grids = Grids(
        np.full((count, height, width), NO_CELL, dtype=np.int32),
        np.zeros((count, size), dtype=np.int32),
        np.zeros((count, size), dtype=np.int32),
        np.zeros((count, size), dtype=np.uint8),
    )
    for number, maze in enumerate(task.mazes):
        own = np.arange(maze.num_cells)
        grids.cells[number, maze.rows, maze.columns] = own
        grids.rows[number, : len(own)], grids.columns[number, : len(own)] = maze.rows, maze.columns
        closed = maze.neighbors[:, :4] == own[:, None]
        grids.walls[number, : len(own)] = closed @ (1 << np.arange(4))
    return grids


@compiled
def encode_window(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    team_size: Any,
    hidden_maze: Any,
    cells: Any,
    rows: Any,
    columns: Any,
    walls: Any,
    out: Any,
) -> None:
    """Fill `out` [games, seats, planes, 2R + 1, 2R + 1]; see `Grids` for the mazes."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    radius = out.shape[3] // 2
    for game in range(out.shape[0]):
        number = np.uintp(games.maze[game])
        for seat in range(out.shape[1]):
            own = np.uintp(order[seat, 0])
            view = view_of(begin, games, game, own)
            at = np.uintp(games.position[game, own])
            top, left = rows[number, at] - radius, columns[number, at] - radius
            out[game, seat] = 0.0
            for row in range(max(0, -top), min(out.shape[3], cells.shape[1] - top)):
                for column in range(max(0, -left), min(out.shape[4], cells.shape[2] - left)):
                    cell = cells[number, top + row, left + column]
                    if cell < 0:
                        continue
                    seen = in_view(table, view, cell)
                    if table is not None and seen:
                        out[game, seat, IN_VIEW_PLANE, row, column] = 1.0
                    if seen or not hidden_maze[own]:
                        out[game, seat, MAZE_PLANES, row, column] = 1.0
                        closed = walls[number, np.uintp(cell)]
                        for side in range(4):
                            wall = np.float32((closed >> side) & 1)
                            out[game, seat, MAZE_PLANES + 1 + side, row, column] = wall
            for index in range(num_goals):
                cell = goal_in_view(games, table, view, game, index)
                if cell >= 0:
                    row, column = rows[number, cell] - top, columns[number, cell] - left
                    if 0 <= row < out.shape[3] and 0 <= column < out.shape[4]:
                        out[game, seat, GOALS_PLANE, row, column] = 1.0
            for entity in range(num_agents):
                agent = np.uintp(order[seat, entity])
                cell = games.position[game, agent]
                if games.active[game, agent] and in_view(table, view, cell):
                    row, column = rows[number, cell] - top, columns[number, cell] - left
                    if 0 <= row < out.shape[3] and 0 <= column < out.shape[4]:
                        out[game, seat, code_of(entity, team_size[seat]) - SELF, row, column] = 1.0
            if has_collected(games, game, own):
                out[game, seat, COLLECTED_PLANE, radius, radius] = 1.0
