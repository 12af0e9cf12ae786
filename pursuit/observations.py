"""Encodings: what one agent observes, and the space of each.

An agent observes *entities*: itself, then the others of its role, then all other agents, then the
goals sorted by cell (those gone first). A captured evader is gone.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit import rules
from pursuit.compiled import compiled, inlined
from pursuit.task import Task

ENCODINGS = ("one_hot", "positions", "cells", "walls", "planes", "index")
FLOOR, SELF, TEAM, OTHER, GOAL, WALL = range(6)
"""Codes of the "cells" and "walls" grids; where several share a cell: self, others, team, goal."""
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


class Encoder:
    """One encoding of one task.

    - "one_hot": float32 [(entities + 1) * cells]: a row for each entity with a 1 at its cell, and
      the just-collected row with a 1 at the agent's own cell if it collected a goal in this step.
    - "positions": int32 [entities + 1]: 1 + cell of each entity, 0 when gone; just collected 0/1.
    - "cells": uint8 [height, width]: the codes FLOOR, SELF, TEAM, OTHER, GOAL, WALL (blocked).
    - "walls": uint8 [2*height + 1, 2*width + 1]: the same with the walls between the cells.
    - "planes": float32 [10, height, width] of 0 and 1, named in PLANES.
    - "index": int32 [entities + 1]: the places of the ones of "one_hot" (gone: its size, a padding
      row), so that an embedding bag that sums rows equals a matrix times "one_hot".

    With several mazes, cells, height and width are those of the largest.

    Args:
        task: the task.
        encoding: one of ENCODINGS.
        mazes: the kernels' description of the mazes (see `Simulator`).

    Raises:
        ValueError: an unknown encoding.

    Attributes:
        shape, dtype: of one observation.
        space: its Gymnasium space (one object, the same at every call).
    """

    def __init__(self, task: Task, encoding: str, mazes: NDArray[np.int64]) -> None:
        if encoding not in ENCODINGS:
            raise ValueError(f"unknown observation {encoding!r}; one of {', '.join(ENCODINGS)}")
        self.encoding, self._agents, self._goals = encoding, task.num_agents, task.num_goals
        self._size, self._mazes = task.max_cells, mazes
        roles = task.seat_roles
        order = [
            sorted(
                range(len(roles)), key=lambda other: (other != seat, roles[other] != role, other)
            )
            for seat, role in enumerate(roles)
        ]
        self._order = np.array(order, dtype=np.int64)
        self._team_size = np.array([roles.count(role) for role in roles], dtype=np.int64)
        self._places, self._background = _grids(task, encoding)
        entities = task.num_agents + task.num_goals
        self.num_entities, self.num_cells = entities, self._size
        box: Any = gymnasium.spaces.Box
        if encoding == "one_hot":
            self.space = box(0.0, 1.0, ((entities + 1) * self._size,), np.float32)
        elif encoding == "positions":
            high = np.array([self._size] * entities + [1], dtype=np.int32)
            self.space = box(np.zeros_like(high), high, dtype=np.int32)
        elif encoding == "index":
            self.space = box(0, (entities + 1) * self._size, (entities + 1,), np.int32)
        elif encoding == "planes":
            self.space = box(0.0, 1.0, self._background.shape[1:], np.float32)
        else:
            self.space = box(FLOOR, WALL, self._background.shape[1:], np.uint8)
        self.shape, self.dtype = self.space.shape, self.space.dtype

    def encode(
        self, rows: NDArray[np.int32], seats: slice = slice(None), out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """[games, seats, *shape]: what these seats observe in these rows of the rule book.

        Raises:
            ValueError: `out` has another shape or dtype.
        """
        order, team = self._order[seats], self._team_size[seats]
        shape = (len(rows), len(order), *self.shape)
        if out is None:
            out = np.empty(shape, self.dtype)
        elif out.shape != shape or out.dtype != self.dtype:
            raise ValueError(
                f"out of shape {out.shape} and dtype {out.dtype}; {self.encoding!r} needs {shape} "
                f"and {self.dtype}"
            )
        elif not out.flags.c_contiguous:
            out[:] = self.encode(rows, seats)
            return out
        if self.encoding == "one_hot":
            encode_one_hot(rows, order, self._goals, self._size, out)
        elif self.encoding == "index":
            encode_index(rows, order, self._goals, self._size, out)
        elif self.encoding == "positions":
            encode_positions(rows, order, self._goals, out)
        else:
            planes = self.encoding == "planes"
            flat = out.reshape(len(rows), len(order), math.prod(self.shape))
            out[:] = self._background[rows[:, -1]][:, None]
            encode_grid(rows, order, team, self._goals, self._places, planes, flat)
        return out


def _grids(task: Task, encoding: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Where each cell lies in the flattened grid [maze, cell], and what never changes."""
    height = max(maze.height for maze in task.mazes)
    width = max(maze.width for maze in task.mazes)
    places = np.zeros((len(task.mazes), task.max_cells), dtype=np.int64)
    if encoding not in ("cells", "walls", "planes"):
        return places, np.zeros(0)
    with_walls = encoding == "walls"
    shape = (2 * height + 1, 2 * width + 1) if with_walls else (height, width)
    if encoding == "planes":
        background = np.zeros((len(task.mazes), len(PLANES), *shape), dtype=np.float32)
    else:
        background = np.full((len(task.mazes), *shape), WALL, dtype=np.uint8)
    for number, maze in enumerate(task.mazes):
        rows, columns = maze.rows, maze.columns
        own = np.arange(maze.num_cells)
        if encoding == "planes":
            background[number, 5, rows, columns] = 1.0
            for action in range(4):
                closed = maze.neighbors[:, action] == own
                background[number, 6 + action, rows, columns] = closed
        elif with_walls:
            rows, columns = 2 * rows + 1, 2 * columns + 1
            background[number, rows, columns] = FLOOR
            for action, (down, right) in enumerate(((-1, 0), (1, 0), (0, 1), (0, -1))):
                joined = maze.neighbors[:, action] != own
                background[number, rows[joined] + down, columns[joined] + right] = FLOOR
        else:
            background[number, rows, columns] = FLOOR
        places[number, : maze.num_cells] = rows * shape[1] + columns
    return places, background


@compiled
def encode_index(rows: Any, order: Any, num_goals: int, size: int, out: Any) -> None:
    """Fill `out` [games, seats, entities + 1] with the places of the ones of "one_hot"."""
    num_agents = order.shape[1]
    last = num_agents + num_goals
    padding = (last + 1) * size
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = order[seat, entity]
                place = entity * size + rows[game, agent]
                out[game, seat, entity] = place if rows[game, num_agents + agent] else padding
            for goal in range(num_goals):
                cell = rows[game, 3 * num_agents + goal]
                entity = num_agents + goal_rank(rows, game, num_agents, num_goals, goal)
                out[game, seat, entity] = entity * size + cell if cell >= 0 else padding
            own = order[seat, 0]
            collected = rows[game, 2 * num_agents + own] & rules.COLLECTED
            out[game, seat, last] = last * size + rows[game, own] if collected else padding


@compiled
def encode_one_hot(rows: Any, order: Any, num_goals: int, size: int, out: Any) -> None:
    """Fill `out` [games, seats, (entities + 1) * size] with a row for each entity."""
    out[:] = 0.0
    num_agents = order.shape[1]
    for game in range(out.shape[0]):
        row = rows[game]
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = order[seat, entity]
                if row[num_agents + agent]:
                    out[game, seat, entity * size + row[agent]] = 1.0
            for goal in range(num_goals):
                cell = row[3 * num_agents + goal]
                if cell >= 0:
                    rank = num_agents + goal_rank(rows, game, num_agents, num_goals, goal)
                    out[game, seat, rank * size + cell] = 1.0
            own = order[seat, 0]
            if row[2 * num_agents + own] & rules.COLLECTED:
                out[game, seat, (num_agents + num_goals) * size + row[own]] = 1.0


@compiled
def encode_positions(rows: Any, order: Any, num_goals: int, out: Any) -> None:
    """Fill `out` [games, seats, entities + 1] with 1 + cell, 0 for gone, and just collected."""
    num_agents = order.shape[1]
    for game in range(out.shape[0]):
        row = rows[game]
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = order[seat, entity]
                out[game, seat, entity] = (row[agent] + 1) * row[num_agents + agent]
            for goal in range(num_goals):
                rank = num_agents + goal_rank(rows, game, num_agents, num_goals, goal)
                out[game, seat, rank] = row[3 * num_agents + goal] + 1
            collected = row[2 * num_agents + order[seat, 0]] & rules.COLLECTED
            out[game, seat, num_agents + num_goals] = 1 if collected else 0


@inlined
def goal_rank(rows: Any, game: int, num_agents: int, num_goals: int, goal: int) -> int:
    """The place of a goal among the goals sorted by cell, those gone first."""
    cell, rank = rows[game, 3 * num_agents + goal], 0
    for other in range(num_goals):
        other_cell = rows[game, 3 * num_agents + other]
        if other_cell < cell or (other_cell == cell and other < goal):
            rank += 1
    return rank


@compiled
def encode_grid(
    rows: Any, order: Any, team_size: Any, num_goals: int, places: Any, planes: bool, out: Any
) -> None:
    """Draw the entities into `out` [games, seats, flattened grid], already holding the maze."""
    num_agents, plane = order.shape[1], places.shape[1]
    for game in range(out.shape[0]):
        row = rows[game]
        where = places[row[-1]]
        if planes:
            plane = out.shape[2] // 10
        for seat in range(out.shape[1]):
            grid = out[game, seat]
            for goal in range(num_goals):
                cell = row[3 * num_agents + goal]
                if cell >= 0:
                    grid[where[cell] + (3 * plane if planes else 0)] = 1.0 if planes else GOAL
            # From the least important to oneself, so that who matters more is drawn over.
            team = team_size[seat]
            for turn in range(num_agents):
                entity = team - 1 - turn if turn < team - 1 else turn + 1
                if turn == num_agents - 1:
                    entity = 0
                agent = order[seat, entity]
                if not row[num_agents + agent]:
                    continue
                code = SELF if entity == 0 else TEAM if entity < team else OTHER
                grid[where[row[agent]] + ((code - 1) * plane if planes else 0)] = (
                    1.0 if planes else code
                )
            own = order[seat, 0]
            if planes and row[2 * num_agents + own] & rules.COLLECTED:
                grid[where[row[own]] + 4 * plane] = 1.0
