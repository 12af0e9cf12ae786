"""The built-in encodings of observations, and their spaces.

An agent observes *entities*: itself, then the other agents of its role, then all other agents, then
the goals sorted by cell (absent ones first), then the exits in the same order. Captured and escaped
evaders and collected goals are absent.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.observations import encodings
from pursuit.observations.custom import (
    AGENT_ID,
    WINDOW,
    CustomEncoding,
    Observation,
    is_builtin,
    without_id,
)
from pursuit.observations.custom import ENCODINGS as ENCODINGS
from pursuit.observations.planes import Planes, radius_of
from pursuit.rules.arrays import Array
from pursuit.rules.layout import Games
from pursuit.rules.visibility import (
    EXIT,
    FLOOR,
    GOAL,
    OTHER,
    SELF,
    TEAM,
    UNSEEN,
    WALL,
)
from pursuit.rules.visibility import PLANES as PLANES
from pursuit.tasks.task import Task, checked_task

DTYPES = ("float32", "uint8")
ZEROS_AND_ONES = ("one_hot", "planes", WINDOW)
"""Encodings of zeros and ones, which have either of DTYPES; by default the first."""
DRAWING_ORDER = (EXIT, GOAL, TEAM, OTHER, SELF)
"""If several entities are in one cell of a grid, the last of these is drawn over the others."""


class Encoder:
    """One encoding of one task.

    - "one_hot": float32 [(entities + 1) * cells]: one row per entity, with a 1 at its cell. The
      last row has a 1 at the agent's own cell if it collected a goal in the last step.
    - "positions": int32 [entities + 1]: 1 + cell of each entity, 0 if absent. The last number is 1
      if the agent collected a goal in the last step, else 0.
    - "cells": uint8 [height, width]: the codes FLOOR, SELF, TEAM, OTHER, GOAL, WALL (blocked),
      EXIT; of graphs [cells].
    - "walls": uint8 [2*height + 1, 2*width + 1]: the same codes, with the walls between the cells.
    - "planes": float32 [10, height, width] of 0 and 1, named in PLANES.
    - "window": float32 [10, 2R+1, 2R+1]: the planes around the agent; cells outside the maze are
      blocked. "window:4" sets R = 4. "window" uses the largest view radius of the task or, without
      one, the smallest R that always shows the whole maze.
    - "index": int32 [entities + 1]: the indices of the ones of "one_hot", for an embedding bag; of
      absent entities its size, a padding row.

    With the suffix "+id" (such as "index+id"), an observation ends with the number of the agent
    among those of its role, as a one of k numbers or k planes, where k is the number of agents of
    the largest role; "index+id" ends with one more row.

    With several mazes, cells, height and width are those of the largest.

    With exits, "planes" and "window" have a last plane "exits". If the task limits views, agents,
    goals and exits out of view are absent. "planes" and "window" then
    have one more plane, "in view", with 1 for visible cells. With `Task.unknown_maze`, cells out of
    view, and walls that are not next to a visible cell, have the code UNSEEN. Planes are 0 there.

    Args:
        task: the task.
        encoding: one of ENCODINGS, or a custom `Observation`: the object, its class, or its name
            "package.module:Name".
        dtype: "uint8" for "one_hot", "planes" and windows in a quarter of the memory; None for the
            dtype above.

    Raises:
        ValueError: an unknown encoding, a custom observation with a space other than Box, a dtype
            that the encoding cannot have, an encoding of rows and columns ("walls", "planes",
            "window") of a graph, or "+id" of "cells" and "walls" in grids.

    Attributes:
        shape, dtype: shape and dtype of one observation.
        space: its Gymnasium space (the same object at every call).
        order: [agents, agents] int64, for each agent the agents in the order of its entities: first
            itself, then those of its role, then the others.
    """

    def __init__(self, task: Task, encoding: str | Observation, dtype: str | None = None) -> None:
        self.encoding: Any = encoding
        self._sight = checked_task(task).sight
        self.num_entities = task.num_agents + task.num_goals + task.most_exits
        self.num_cells = task.max_cells
        roles = task.seat_roles
        order = [
            sorted(
                range(len(roles)), key=lambda other: (other != seat, roles[other] != role, other)
            )
            for seat, role in enumerate(roles)
        ]
        self.order = np.array(order, dtype=np.int64)
        same_role = np.array(roles)[self.order] == np.array(roles)[:, None]
        self._codes = np.where(same_role, TEAM, OTHER)
        self._codes[:, 0] = SELF
        self._plain: Encoder | None = None
        self._own: CustomEncoding | None = None
        if isinstance(encoding, str) and encoding.endswith(AGENT_ID):
            self._plain = Encoder(task, without_id(encoding), dtype)
            self._ids = [roles[:seat].count(role) for seat, role in enumerate(roles)]
            self.space: Any = _space_with_id(self._plain, max(self._ids) + 1)
        elif is_builtin(encoding):
            self.space = self._space(task)
        else:
            self._own = CustomEncoding(task, encoding)
            self.space = self._own.space
        self.shape, self.dtype = self.space.shape, self.space.dtype
        if dtype is not None:
            _check_dtype(encoding, dtype, str(self.dtype))
            self.dtype = np.dtype(dtype)
            bounds = self.space.low.astype(dtype), self.space.high.astype(dtype)
            self.space = gymnasium.spaces.Box(*bounds, dtype=self.dtype.type)

    def _space(self, task: Task) -> gymnasium.spaces.Box:
        """The space of a built-in encoding; also creates the arrays that its kernels need."""
        box: Any = gymnasium.spaces.Box
        entities, cells = self.num_entities, self.num_cells
        if self.encoding == "one_hot":
            return box(0.0, 1.0, ((entities + 1) * cells,), np.float32)
        if self.encoding == "positions":
            high = np.array([cells] * entities + [1], dtype=np.int32)
            return box(np.zeros_like(high), high, dtype=np.int32)
        if self.encoding == "index":
            return box(0, (entities + 1) * cells, (entities + 1,), np.int32)
        graph = next((maze.name for maze in task.mazes if not maze.is_grid), None)
        if graph is not None and self.encoding != "cells":
            raise ValueError(
                f"observation {self.encoding!r} shows rows and columns, and {graph} is a graph; "
                "use 'index', 'one_hot', 'positions' or 'cells'"
            )
        if self.encoding in ("cells", "walls"):
            self._places, self._background = _drawn_mazes(task, self.encoding == "walls")
            self._draws = _draws(self._codes, task.num_goals, task.most_exits)
            most = UNSEEN if self._sight.hidden_maze.any() else WALL
            most = EXIT if task.most_exits else most
            return box(FLOOR, most, self._background.shape[1:], np.uint8)
        radius = None if self.encoding == "planes" else radius_of(task, self.encoding)
        self._planes = Planes(task, radius)
        return box(0.0, 1.0, self._planes.shape, np.float32)

    def encode(self, games: Games, seats: slice = slice(None), out: Array | None = None) -> Array:
        """[games, seats, *shape]: the observations of these agents in these games.

        Raises:
            ValueError: `out` has another shape or dtype.
        """
        shape = (len(games.steps), len(self.order[seats]), *self.shape)
        if out is None:
            out = np.empty(shape, self.dtype)
        elif not isinstance(out, np.ndarray):
            raise ValueError(f"out={out!r}; give an array of shape {shape} and dtype {self.dtype}")
        elif out.shape != shape or out.dtype != self.dtype:
            raise ValueError(
                f"out of shape {out.shape} and dtype {out.dtype}; {self.encoding!r} needs {shape} "
                f"and {self.dtype}"
            )
        if self._plain is not None:
            self._fill_with_id(self._plain.encode(games, seats), self._ids[seats], out)
        elif self._own is not None:
            out[:] = self._own.encode(games, seats)
        elif not out.flags.c_contiguous:
            out[:] = self.encode(games, seats)
        else:
            self._fill(games, seats, out)
        return out

    def _fill_with_id(self, seen: Array, ids: list[int], out: Array) -> None:
        """Fill `out` with observations, followed by the number of each agent."""
        most = seen.shape[2]
        out[:, :, :most], out[:, :, most:] = seen, 0
        for seat, number in enumerate(ids):
            if without_id(self.encoding) == "index":
                out[:, seat, most] = most * self.num_cells + 1 + number
            else:
                out[:, seat, most + number] = 1

    def _fill(self, games: Games, seats: slice, out: Array) -> None:
        """Fill `out`, which is contiguous, with a built-in encoding."""
        order, size, sight = self.order[seats], self.num_cells, self._sight
        seen_from = (*games, sight.table, sight.begin, order)
        if self.encoding == "index":
            encodings.list_entities(*seen_from, 0, size, out.shape[2] * size, out)
        elif self.encoding == "positions":
            encodings.list_entities(*seen_from, 1, 0, 0, out)
            np.minimum(out[:, :, -1], 1, out=out[:, :, -1])
        elif self.encoding == "one_hot":
            encodings.list_entities(*seen_from, 0, size, None, out)
        elif self.encoding not in ("cells", "walls"):
            self._planes.draw(games, seats, out)
        else:
            seen = np.empty((*out.shape[:2], self.num_entities + 1), dtype=np.int32)
            encodings.list_entities(*seen_from, 0, 0, -1, seen)
            hidden = sight.hidden_maze[seats]
            out[:] = self._background[games.maze][:, None]
            flat = out.reshape(*out.shape[:2], math.prod(self.shape))
            if hidden.any():
                mazes = self._background.reshape(len(self._background), -1)
                grids = (self._places, mazes, self.shape[1], int(self.encoding == "walls"))
                # With hidden mazes there is a table of views.
                encodings.hide_grid(*seen_from, hidden, *grids, flat)  # type: ignore[arg-type]
            encodings.draw_codes(seen, games.maze, self._draws[seats], self._places, flat)


def _check_dtype(encoding: object, dtype: object, own: str) -> None:
    """ValueError unless an encoding, by default of dtype `own`, can have another dtype."""
    if dtype not in (DTYPES if has_bits(encoding) else (own,)):
        raise ValueError(
            f"observation_dtype={dtype!r} of observation {encoding!r}, which is {own}; only "
            f"{', '.join(ZEROS_AND_ONES)} and {WINDOW}:R can be {' or '.join(DTYPES)}: leave it out"
        )


def has_bits(encoding: object) -> bool:
    """Whether an encoding consists of zeros and ones, and so has either of DTYPES."""
    return is_builtin(encoding) and without_id(str(encoding)).partition(":")[0] in ZEROS_AND_ONES


def _space_with_id(plain: Encoder, members: int) -> gymnasium.spaces.Box:
    """The space of an encoding with the numbers of so many agents at its end."""
    low, high, box = plain.space.low, plain.space.high, gymnasium.spaces.Box
    if plain.encoding == "index":
        most = int(high[0]) + members
        return box(0, most, (len(high) + 1,), np.int32)
    if low.ndim not in (1, 3):
        raise ValueError(
            f"observation {plain.encoding + AGENT_ID!r} has no place for the number of the agent; "
            f"leave {AGENT_ID} out (agent_id=False), or use index, one_hot, positions, planes or "
            "window:R"
        )
    more = np.zeros((members, *low.shape[1:]), low.dtype)
    return box(np.concatenate([low, more]), np.concatenate([high, more + 1]), dtype=low.dtype)


def _draws(codes: NDArray[np.int64], num_goals: int, num_exits: int) -> NDArray[np.int64]:
    """[seats, entities, 2]: (entity, code) in drawing order; `codes` are those of the agents."""
    places = np.repeat([GOAL, EXIT], [num_goals, num_exits])
    of_all = np.concatenate([codes, np.tile(places, (len(codes), 1))], axis=1)
    drawn = np.array([[DRAWING_ORDER.index(code) for code in row] for row in of_all.tolist()])
    turns = np.argsort(drawn, axis=1, kind="stable")
    return np.stack([turns, np.take_along_axis(of_all, turns, axis=1)], axis=2)


def _drawn_mazes(task: Task, with_walls: bool) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """The index of each cell in the flattened grid [maze, cell], and the grids of empty mazes."""
    places = np.zeros((len(task.mazes), task.max_cells), dtype=np.int64)
    if not all(maze.is_grid for maze in task.mazes):
        places[:] = np.arange(task.max_cells)
        there = places < np.array([[maze.num_cells] for maze in task.mazes])
        return places, np.where(there, FLOOR, WALL).astype(np.uint8)
    height = max(maze.height for maze in task.mazes)
    width = max(maze.width for maze in task.mazes)
    shape = (2 * height + 1, 2 * width + 1) if with_walls else (height, width)
    background = np.full((len(task.mazes), *shape), WALL, dtype=np.uint8)
    for number, maze in enumerate(task.mazes):
        rows, columns = maze.rows, maze.columns
        if with_walls:
            rows, columns = 2 * rows + 1, 2 * columns + 1
            for action, (down, right) in enumerate(((-1, 0), (1, 0), (0, 1), (0, -1))):
                is_open = maze.neighbors[:, action] != np.arange(maze.num_cells)
                background[number, rows[is_open] + down, columns[is_open] + right] = FLOOR
        background[number, rows, columns] = FLOOR
        places[number, : maze.num_cells] = rows * shape[1] + columns
    return places, background
