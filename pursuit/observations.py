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

from pursuit import encodings
from pursuit.own_observations import ENCODINGS as ENCODINGS
from pursuit.own_observations import WINDOW, Observation, OwnEncoding, is_ours
from pursuit.rules.layout import Games
from pursuit.rules.sight import FLOOR, UNSEEN, WALL
from pursuit.rules.sight import PLANES as PLANES
from pursuit.task import Task, checked_task
from pursuit.window import encode_window, grids_of, planes_of, radius_of


class Encoder:
    """One encoding of one task.

    - "one_hot": float32 [(entities + 1) * cells]: a row for each entity with a 1 at its cell, and
      the just-collected row with a 1 at the agent's own cell if it collected a goal in this step.
    - "positions": int32 [entities + 1]: 1 + cell of each entity, 0 when gone; just collected 0/1.
    - "cells": uint8 [height, width]: the codes FLOOR, SELF, TEAM, OTHER, GOAL, WALL (blocked).
    - "walls": uint8 [2*height + 1, 2*width + 1]: the same with the walls between the cells.
    - "planes": float32 [10, height, width] of 0 and 1, named in PLANES.
    - "window": float32 [10, 2R+1, 2R+1], the planes of what lies around the agent, who is in the
      middle: the same for mazes of any size, outside of which nothing is walkable. "window:4" has
      R = 4; "window" the largest view radius of the task, or one that always shows the whole maze.
    - "index": int32 [entities + 1]: the places of the ones of "one_hot" (gone: its size, a padding
      row), so that an embedding bag that sums rows equals a matrix times "one_hot".

    With several mazes, cells, height and width are those of the largest.

    Where the task limits sight, who and what an agent does not see is as if gone, and "planes"
    and "window" have one plane more, "in view": 1 for the cells that are seen. Who knows of the
    maze only what is within view (`Task.unknown_maze`) is shown the code UNSEEN in place of all
    other cells, and of the walls that are not beside a cell in view; on planes all numbers of other
    cells are 0.

    Args:
        task: the task.
        encoding: one of ENCODINGS, or an `Observation` of your own: itself, its class, or its name
            "package.module:Name".

    Raises:
        ValueError: an unknown encoding, or an observation without a Box as its space.

    Attributes:
        shape, dtype: of one observation.
        space: its Gymnasium space (one object, the same at every call).
    """

    def __init__(self, task: Task, encoding: str | Observation) -> None:
        self.encoding: Any = encoding
        self._size = checked_task(task).max_cells
        self._own: OwnEncoding | None = None
        self.num_entities, self.num_cells = task.num_agents + task.num_goals, task.max_cells
        roles = task.seat_roles
        order = [
            sorted(
                range(len(roles)), key=lambda other: (other != seat, roles[other] != role, other)
            )
            for seat, role in enumerate(roles)
        ]
        self._order = np.array(order, dtype=np.int64)
        self._team_size = np.array([roles.count(role) for role in roles], dtype=np.int64)
        if not is_ours(encoding):
            self._own = OwnEncoding(task, encoding)
            self.space = self._own.space
            self.shape, self.dtype = self.space.shape, self.space.dtype
            return
        self._sight = task.sight
        self._table, self._begin = self._sight.table, self._sight.begin
        self._places, self._background = _grids(task, str(encoding))
        self._is_window = str(encoding).startswith(WINDOW)
        entities = self.num_entities
        box: Any = gymnasium.spaces.Box
        if encoding == "one_hot":
            self.space = box(0.0, 1.0, ((entities + 1) * self._size,), np.float32)
        elif encoding == "positions":
            high = np.array([self._size] * entities + [1], dtype=np.int32)
            self.space = box(np.zeros_like(high), high, dtype=np.int32)
        elif encoding == "index":
            self.space = box(0, (entities + 1) * self._size, (entities + 1,), np.int32)
        elif self._is_window:
            side = 2 * radius_of(task, str(encoding)) + 1
            self.space = box(0.0, 1.0, (len(planes_of(task)), side, side), np.float32)
            self._mazes = grids_of(task)
        elif encoding == "planes":
            self.space = box(0.0, 1.0, self._background.shape[1:], np.float32)
        else:
            self.space = box(
                FLOOR,
                UNSEEN if self._sight.hidden_maze.any() else WALL,
                self._background.shape[1:],
                np.uint8,
            )
        self.shape, self.dtype = self.space.shape, self.space.dtype

    def encode(
        self, games: Games, seats: slice = slice(None), out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """[games, seats, *shape]: what these seats observe in these games, played or not.

        Raises:
            ValueError: `out` has another shape or dtype.
        """
        seen = None if self._own is None else self._own.encode(games, seats)
        if seen is not None and out is None:
            return seen
        order, team = self._order[seats], self._team_size[seats]
        shape = (len(games.steps), len(order), *self.shape)
        if out is None:
            out = np.empty(shape, self.dtype)
        elif not isinstance(out, np.ndarray):
            raise ValueError(f"out={out!r}; give an array of shape {shape} and dtype {self.dtype}")
        elif out.shape != shape or out.dtype != self.dtype:
            raise ValueError(
                f"out of shape {out.shape} and dtype {out.dtype}; {self.encoding!r} needs {shape} "
                f"and {self.dtype}"
            )
        elif seen is not None or not out.flags.c_contiguous:
            out[:] = self.encode(games, seats) if seen is None else seen
            return out
        table, begin = self._table, self._begin
        if self.encoding == "index":
            encodings.encode_index(*games, table, begin, order, self._size, out)
            return out
        seen_from = (*games, table, begin, order)
        if self.encoding == "one_hot":
            encodings.encode_one_hot(*seen_from, self._size, out)
        elif self.encoding == "positions":
            encodings.encode_positions(*seen_from, out)
        elif self._is_window:
            encode_window(*seen_from, team, self._sight.hidden_maze, *self._mazes, out)
        else:
            self._draw(games, order, team, out)
        return out

    def _draw(
        self, games: Games, order: NDArray[np.int64], team: NDArray[np.int64], out: NDArray[Any]
    ) -> None:
        """Fill `out` of a grid or of planes."""
        sight, hidden = self._sight, self._sight.hidden_maze
        seen_from = (*games, sight.table, sight.begin, order)
        out[:] = self._background[games.maze][:, None]
        if self.encoding == "planes":
            flat = out.reshape(*out.shape[:3], math.prod(self.shape[1:]))
            if sight.limited:
                encodings.mark_view(*seen_from, hidden, self._places, flat)
            encodings.encode_planes(*seen_from, team, self._places, flat)
            return
        flat = out.reshape(*out.shape[:2], math.prod(self.shape))
        if hidden.any():
            mazes = self._background.reshape(len(self._background), -1)
            reach, columns = int(self.encoding == "walls"), self.shape[1]
            encodings.hide_grid(*seen_from, hidden, self._places, mazes, reach, columns, flat)
        encodings.encode_grid(*seen_from, team, self._places, flat)


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
        planes = (len(task.mazes), len(planes_of(task)), *shape)
        background = np.zeros(planes, dtype=np.float32)
    else:
        background = np.full((len(task.mazes), *shape), WALL, dtype=np.uint8)
    for number, maze in enumerate(task.mazes):
        rows, columns = maze.rows, maze.columns
        own = np.arange(maze.num_cells)
        if encoding == "planes":
            background[number, PLANES.index("walkable"), rows, columns] = 1.0
            for action, side in enumerate(("north", "south", "east", "west")):
                closed = maze.neighbors[:, action] == own
                background[number, PLANES.index(f"wall {side}"), rows, columns] = closed
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
