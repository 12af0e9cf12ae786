"""The states passed to custom reward functions and observations.

They are NamedTuples of arrays, so functions of them can be compiled by Numba.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rules import layout

ROLES = ("chaser", "evader", "runner")
"""The role names in the order of the constants CHASER, EVADER and RUNNER."""


class Before(NamedTuple):
    """The state of a batch of games; the constants are in `pursuit.rules`.

    Attributes:
        positions: [games, agents] int32, cells; a captured or escaped evader stays where it was.
        active: [games, agents] int32, 1; 0 after capture and escape.
        events: [games, agents] int32, the events of the last step: a sum of COLLECTED, CAPTURED,
            WAS_CAPTURED and ESCAPED.
        goals: [games, goals] int32, cells; -1 for collected goals.
        steps: [games] int32, the steps taken in this episode.
        maze_index: [games] int32, the index of the game's maze among the mazes of the task.
        exits: [games, exits] int32, cells; -1 for absent ones.
        roles: [agents] int32, CHASER, EVADER or RUNNER.
        distances: [mazes, cells, cells] int32, read-only, shortest path lengths; UNREACHABLE if
            there is no path. [mazes, 0, 0] if a maze is too large for a table.
    """

    positions: NDArray[np.int32]
    active: NDArray[np.int32]
    events: NDArray[np.int32]
    goals: NDArray[np.int32]
    steps: NDArray[np.int32]
    maze_index: NDArray[np.int32]
    exits: NDArray[np.int32]
    roles: NDArray[np.int32]
    distances: NDArray[np.int32]


class After(NamedTuple):
    """The state of a batch of games after a step and before any restart, with its results.

    Attributes:
        positions, active, events, goals, steps, maze_index, exits, roles, distances: as of
            `Before`.
        terminated, truncated: [games] bool, whether the step ended the game.
        rewards: [games, agents] float32, the rewards of the scheme "goal".
    """

    positions: NDArray[np.int32]
    active: NDArray[np.int32]
    events: NDArray[np.int32]
    goals: NDArray[np.int32]
    steps: NDArray[np.int32]
    maze_index: NDArray[np.int32]
    exits: NDArray[np.int32]
    roles: NDArray[np.int32]
    distances: NDArray[np.int32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    rewards: NDArray[np.float32]


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
