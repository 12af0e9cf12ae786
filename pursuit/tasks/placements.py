"""Check that start placements with the given distances between chasers and evaders exist.

`rules.starts` draws placements until one satisfies the limits, so that starts are uniform over all
valid placements. Limits that are satisfied too rarely for that are rejected here.

Distances are path lengths. The distance between cells without a connecting path is infinite.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rules import UNREACHABLE
from pursuit.rules.layout import Teams

TRIES = 1000
"""Random placements of the chasers, and of the evaders for each; one of them must be valid."""
TRIES_WITHOUT_TABLE = 20
"""The same for chasers in mazes without a table of distances, where each needs searches."""


class StartConstraint(NamedTuple):
    """Limits on the placement of chasers and evaders in one maze.

    Attributes:
        maze: the maze.
        teams: the numbers of agents and goals.
        marked: whether agents start on the marks of the maze.
        num_goals: the number of goals at the start, if they are placed on marks.
        least, most: path distance between any chaser and any evader; `most` -1 means no limit.
        exits: the fixed exits, on which no evader starts.
    """

    maze: Maze
    teams: Teams
    marked: bool
    num_goals: int
    least: int
    most: int
    exits: tuple[int, ...] = ()


def check_placeable(asked: StartConstraint) -> None:
    """Check that one of many random placements satisfies the limits.

    Raises:
        ValueError: none does.
    """
    maze, (chasers, evaders) = asked.maze, asked.teams[:2]
    unlimited = not asked.exits and asked.least <= 1 and asked.most < 0
    if not evaders or (not chasers and not asked.exits) or unlimited or _was_found(asked):
        return
    limits = [f"min_start_distance={asked.least}"] if asked.least > 1 else []
    limits += [f"max_start_distance={asked.most}"] if asked.most >= 0 else []
    limits += [f"exits={asked.exits}"] if asked.exits else []
    longest = ""
    if maze.num_cells <= MAX_TABLE_CELLS:
        longest = f" (longest distance: {maze.longest_distance})"
    raise ValueError(
        f"{' and '.join(limits)}: no random placement of {chasers} chaser(s) and {evaders} "
        f"evader(s) {'with marks ' if asked.marked else ''}satisfies this in {maze.name}{longest}. "
        "Lower the minimum, raise the maximum, or use another maze or fewer agents"
    )


@lru_cache(maxsize=256)
def _was_found(asked: StartConstraint) -> bool:
    """Whether one of many random placements is valid; drawn with a fixed seed."""
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
        right[list(asked.exits)] = False
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
