"""The mazes of the axes `maze-size` and `loops`, from easy to hard."""

from __future__ import annotations

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.tasks.task import Task
from pursuit.validation import check
from train.settings.mazes import named_maze, names_in

OPENED = 8
"""Number of mazes of the axis `loops`, from no inner walls to all inner walls of the maze."""


def training_mazes(name: str, given: str | None, task: Task) -> tuple[Maze, ...]:
    """The mazes of the axes `maze-size` and `loops`, from easy to hard; the last is the task's.

    By default `maze-size` uses the first k rows of the maze for increasing k. Cells keep their
    numbers in these, so a policy applies to all of them. `loops` uses the maze with fewer and fewer
    inner walls removed.

    Raises:
        ValueError: an unknown maze, one that is too small or larger than the task's, or no easier
            maze exists.
    """
    final, needed = task.mazes[0], task.num_agents + task.num_goals
    check(
        final.is_grid,
        f"curriculum {name!r} makes easier mazes, and {final.name} is a graph; use another axis, "
        "such as start-distance",
    )
    if given is not None:
        mazes = [maze for maze in map(named_maze, names_in(given)) if maze != final]
        for maze in mazes:
            check(
                maze.height <= final.height
                and maze.width <= final.width
                and maze.num_cells <= final.num_cells,
                f"curriculum_mazes: {maze.name} is larger than the task's maze {final.name}, which "
                "is the last and largest; leave it out",
            )
            check(
                needed <= maze.num_cells,
                f"curriculum_mazes: {maze.name} has {maze.num_cells} cells, and the agents and "
                f"goals need {needed}; leave it out",
            )
    elif name == "maze-size":
        mazes = [band for k in range(1, final.height) if (band := first_rows(final, k, needed))]
    else:
        mazes = [opened(final, 1.0 - k / (OPENED - 1)) for k in range(OPENED - 1)]
        mazes = list(dict.fromkeys(maze for maze in mazes if maze != final))
    check(
        bool(mazes),
        f"curriculum {name!r} has no easier maze than {final.name}; give curriculum_mazes",
    )
    return (*mazes, final)


def first_rows(maze: Maze, rows: int, needed: int) -> Maze | None:
    """The first rows of `maze`; None if they are not connected or have too few cells."""
    walkable = maze.cell_numbers[:rows] >= 0
    if walkable.sum() < max(needed, 2):
        return None
    part = Maze(
        walkable,
        maze.open_south[: rows - 1],
        maze.open_east[:rows],
        name=f"{maze.name}, {rows} rows",
    )
    return part if part.is_connected else None


def opened(maze: Maze, share: float) -> Maze:
    """`maze` without this share of its inner walls, which are removed in a fixed order."""
    south, east = maze.open_south.copy(), maze.open_east.copy()
    walkable = maze.cell_numbers >= 0
    walls_south = np.argwhere(~south & walkable[:-1] & walkable[1:])
    walls_east = np.argwhere(~east & walkable[:, :-1] & walkable[:, 1:])
    walls = [(south, tuple(w)) for w in walls_south] + [(east, tuple(w)) for w in walls_east]
    order = np.random.default_rng(0).permutation(len(walls))
    for number in order[: round(share * len(walls))]:
        table, place = walls[number]
        table[place] = True
    marks = {
        "start": None if maze.start_mark is None else _place(maze, maze.start_mark),
        "goals": tuple(_place(maze, mark) for mark in maze.goal_marks),
    }
    return Maze(walkable, south, east, **marks, name=f"{maze.name}, {100 * share:.0f} % open")  # type: ignore[arg-type]


def _place(maze: Maze, cell: int) -> tuple[int, int]:
    return int(maze.rows[cell]), int(maze.columns[cell])
