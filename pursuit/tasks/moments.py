"""Moments: the games as a user's own reward function or observation is given them.

Plain arrays under readable names, in NamedTuples: a function over them may be compiled by Numba.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rules import layout
from pursuit.rules.layout import Games

ROLES = ("chaser", "evader", "runner")
"""In the order of the numbers CHASER, EVADER and RUNNER."""


class Before(NamedTuple):
    """The games at one moment; `pursuit.rules` has the constants.

    Attributes:
        positions: [games, agents] int32, cells; a captured evader keeps that of its capture.
        active: [games, agents] int32, 1, or 0 after capture.
        events: [games, agents] int32, what the step that led here brought: a sum of COLLECTED,
            CAPTURED and WAS_CAPTURED.
        goals: [games, goals] int32, cells; -1 when gone.
        steps: [games] int32, taken in this episode.
        maze_index: [games] int32, which of the task's mazes each game plays in.
        roles: [agents] int32, CHASER, EVADER or RUNNER.
        distances: [mazes, cells, cells] int32, steps on a shortest path, UNREACHABLE where there is
            none; read-only, and [mazes, 0, 0] where a maze is too large for a table.
    """

    positions: Any
    active: Any
    events: Any
    goals: Any
    steps: Any
    maze_index: Any
    roles: Any
    distances: Any


class After(NamedTuple):
    """The games after a step, before any of them begins anew: `Before`, and what the step led to.

    Attributes:
        positions, active, events, goals, steps, maze_index, roles, distances: as of `Before`.
        terminated, truncated: [games] bool, whether the step ended the game.
        rewards: [games, agents] float32, what the coefficients of the scheme "goal" would pay.
    """

    positions: Any
    active: Any
    events: Any
    goals: Any
    steps: Any
    maze_index: Any
    roles: Any
    distances: Any
    terminated: Any
    truncated: Any
    rewards: Any


def moment_of(games: Games, roles: Any, distances: Any) -> Before:
    """The games as they stand: views of them, not copies."""
    return Before(*games, roles, distances)


def roles_of(seat_roles: Sequence[str]) -> NDArray[np.int32]:
    """[agents] int32: CHASER, EVADER or RUNNER."""
    return np.array([ROLES.index(role) for role in seat_roles], dtype=np.int32)


@lru_cache(maxsize=4)
def distances_of(mazes: tuple[Maze, ...]) -> NDArray[np.int32]:
    """[mazes, cells, cells] int32, read-only; [mazes, 0, 0] where a maze has no table."""
    size = max(maze.num_cells for maze in mazes)
    if size > MAX_TABLE_CELLS:
        size = 0
    elif len(mazes) == 1:
        return mazes[0].distances[None]
    table = np.full((len(mazes), size, size), layout.UNREACHABLE, dtype=np.int32)
    for number, maze in enumerate(mazes if size else ()):
        table[number, : maze.num_cells, : maze.num_cells] = maze.distances
    table.flags.writeable = False
    return table
