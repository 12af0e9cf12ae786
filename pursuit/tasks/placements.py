"""Placements: whether chasers and evaders can start as far apart, and as near, as is asked.

The rule book draws placements until one holds (`rules.starts`), so that starts are uniform over all
that hold. What holds too rarely for that is refused here, as the distances are set.

Distances are path steps. Cells that no path joins are infinitely far apart: every minimum holds
for them, and no maximum does.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rules import UNREACHABLE
from pursuit.rules.layout import Teams

TRIES = 1000
"""Random placements of the chasers, and of the evaders for each of them, of which one must hold."""
TRIES_WITHOUT_TABLE = 20
"""Placements of the chasers in mazes without a table of distances, where each takes searches."""


class StartConstraint(NamedTuple):
    """How chasers and evaders are to be placed in one maze.

    Attributes:
        maze: where.
        teams: how many of each there are.
        marked: whether agents that have a mark start on it.
        num_goals: the goals that the episode begins with, where they start on marks.
        least, most: path steps between every chaser and every evader; no maximum is -1.
    """

    maze: Maze
    teams: Teams
    marked: bool
    num_goals: int
    least: int
    most: int


def check_placeable(asked: StartConstraint) -> None:
    """Refuse what no placement meets, or so few that none of many random ones does.

    Raises:
        ValueError: none was found.
    """
    maze, (chasers, evaders) = asked.maze, asked.teams[:2]
    if not chasers or not evaders or (asked.least <= 1 and asked.most < 0) or _was_found(asked):
        return
    wishes = [f"min_start_distance={asked.least}"] if asked.least > 1 else []
    wishes += [f"max_start_distance={asked.most}"] if asked.most >= 0 else []
    longest = ""
    if maze.num_cells <= MAX_TABLE_CELLS:
        longest = f", whose longest distance is {maze.longest_distance}"
    raise ValueError(
        f"{' and '.join(wishes)}: no random placement of {chasers} chaser(s) and {evaders} "
        f"evader(s) {'with marks ' if asked.marked else ''}is so in maze {maze.name}{longest}. "
        "Lower the minimum, raise the maximum, or take another maze or fewer agents"
    )


@lru_cache(maxsize=256)
def _was_found(asked: StartConstraint) -> bool:
    """Whether one of many random placements holds; drawn from a seed of their own."""
    maze, (chasers, evaders) = asked.maze, asked.teams[:2]
    has_table = maze.num_cells <= MAX_TABLE_CELLS
    if has_table:
        _ = maze.distances  # `distances_from` looks there
    taken = list(maze.goal_marks[: asked.num_goals]) if asked.marked else []
    rng = np.random.default_rng(0)
    for _ in range(TRIES if has_table else TRIES_WITHOUT_TABLE):
        cells = rng.integers(maze.num_cells, size=(TRIES, chasers + evaders))
        cells[:, :chasers] = cells[0, :chasers]
        if asked.marked and maze.start_mark is not None:
            cells[:, 0] = maze.start_mark
        if asked.marked and not asked.teams.goals:
            marks = maze.goal_marks[:evaders]
            cells[:, chasers : chasers + len(marks)] = marks
        right = np.ones(maze.num_cells, dtype=bool)
        for cell in cells[0, :chasers].tolist():
            away = maze.distances_from(cell)
            right &= away >= asked.least
            if asked.most >= 0:
                right &= (away <= asked.most) & (away != UNREACHABLE)
        found = cells[right[cells[:, chasers:]].all(axis=1)]
        ordered = np.sort(found, axis=1)
        distinct = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
        if (distinct & ~np.isin(found, taken).any(axis=1)).any():
            return True
    return False
