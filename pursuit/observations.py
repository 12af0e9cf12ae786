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

from pursuit.compiled import compiled, inlined
from pursuit.own_observations import ENCODINGS as ENCODINGS
from pursuit.own_observations import Observation, OwnEncoding
from pursuit.rules.layout import COLLECTED, Games
from pursuit.task import Task, checked_task

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
"""The first three follow the codes from SELF on."""
GOALS_PLANE, COLLECTED_PLANE = PLANES.index("goals"), PLANES.index("just collected")


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
        if encoding not in ENCODINGS:
            self._own = OwnEncoding(task, encoding)
            self.space = self._own.space
            self.shape, self.dtype = self.space.shape, self.space.dtype
            return
        self._places, self._background = _grids(task, str(encoding))
        entities = self.num_entities
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
        if self.encoding == "one_hot":
            encode_one_hot(*games, order, self._size, out)
        elif self.encoding == "index":
            encode_index(*games, order, self._size, out)
        elif self.encoding == "positions":
            encode_positions(*games, order, out)
        else:
            out[:] = self._background[games.maze][:, None]
            flat = out.reshape(*shape[:2], math.prod(self.shape))
            if self.encoding == "planes":
                flat = flat.reshape(*shape[:2], len(PLANES), math.prod(self.shape[1:]))
                encode_planes(*games, order, team, self._places, flat)
            else:
                encode_grid(*games, order, team, self._places, flat)
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


# -- kernels ---------------------------------------------------------------------------------------


@compiled
def encode_index(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    order: Any,
    size: int,
    out: Any,
) -> None:
    """Fill `out` [games, seats, entities + 1] with the places of the ones of "one_hot"."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    last = num_agents + num_goals
    padding = (last + 1) * size
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = np.uintp(order[seat, entity])  # unsigned: faster
                place = entity * size + games.position[game, agent]
                out[game, seat, entity] = place if games.active[game, agent] else padding
            for number in range(num_goals):
                cell = games.goal[game, number]
                entity = num_agents + goal_rank(games, game, number)
                out[game, seat, entity] = entity * size + cell if cell >= 0 else padding
            own = np.uintp(order[seat, 0])
            place = last * size + games.position[game, own]
            out[game, seat, last] = place if has_collected(games, game, own) else padding


@compiled
def encode_one_hot(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    order: Any,
    size: int,
    out: Any,
) -> None:
    """Fill `out` [games, seats, (entities + 1) * size] with a row for each entity."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    out[:] = 0.0
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = order[seat, entity]
                if games.active[game, agent]:
                    out[game, seat, entity * size + games.position[game, agent]] = 1.0
            for number in range(num_goals):
                cell = games.goal[game, number]
                if cell >= 0:
                    entity = num_agents + goal_rank(games, game, number)
                    out[game, seat, entity * size + cell] = 1.0
            own = order[seat, 0]
            if has_collected(games, game, own):
                last = num_agents + num_goals
                out[game, seat, last * size + games.position[game, own]] = 1.0


@compiled
def encode_positions(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    order: Any,
    out: Any,
) -> None:
    """Fill `out` [games, seats, entities + 1] with 1 + cell, 0 for gone, and just collected."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            for entity in range(num_agents):
                agent = order[seat, entity]
                cell = games.position[game, agent]
                out[game, seat, entity] = cell + 1 if games.active[game, agent] else 0
            for number in range(num_goals):
                entity = num_agents + goal_rank(games, game, number)
                out[game, seat, entity] = games.goal[game, number] + 1
            own = order[seat, 0]
            out[game, seat, num_agents + num_goals] = has_collected(games, game, own)


@inlined
def has_collected(games: Games, game: int, agent: int | np.uintp) -> bool:
    """Whether an agent collected a goal in the last step."""
    return (games.event[game, agent] & COLLECTED) != 0


@inlined
def goal_rank(games: Games, game: int, goal: int) -> int:
    """The place of a goal among the goals sorted by cell, those gone first."""
    cell, rank = games.goal[game, goal], 0
    for other in range(games.goal.shape[1]):
        other_cell = games.goal[game, other]
        if other_cell < cell or (other_cell == cell and other < goal):
            rank += 1
    return rank


@inlined
def code_of(entity: int, team_size: int) -> int:
    """What an agent is to the observer, whose own team comes first in the order of entities."""
    return SELF if entity == 0 else TEAM if entity < team_size else OTHER


@compiled
def encode_grid(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    order: Any,
    team_size: Any,
    places: Any,
    out: Any,
) -> None:
    """Draw the entities into `out` [games, seats, flattened grid], already holding the maze."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        where = places[games.maze[game]]
        for seat in range(out.shape[1]):
            for number in range(num_goals):
                if games.goal[game, number] >= 0:
                    out[game, seat, where[games.goal[game, number]]] = GOAL
            # From the least important to oneself, so that who matters more is drawn over.
            team = team_size[seat]
            for turn in range(num_agents):
                entity = team - 1 - turn if turn < team - 1 else turn + 1
                if turn == num_agents - 1:
                    entity = 0
                agent = order[seat, entity]
                if games.active[game, agent]:
                    place = where[games.position[game, agent]]
                    out[game, seat, place] = code_of(entity, team)


@compiled
def encode_planes(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    order: Any,
    team_size: Any,
    places: Any,
    out: Any,
) -> None:
    """Mark the entities in `out` [games, seats, planes, flattened plane], already with the maze."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        where = places[games.maze[game]]
        for seat in range(out.shape[1]):
            for number in range(num_goals):
                if games.goal[game, number] >= 0:
                    out[game, seat, GOALS_PLANE, where[games.goal[game, number]]] = 1.0
            for entity in range(num_agents):
                agent = order[seat, entity]
                if games.active[game, agent]:
                    place = where[games.position[game, agent]]
                    out[game, seat, code_of(entity, team_size[seat]) - SELF, place] = 1.0
            own = order[seat, 0]
            if has_collected(games, game, own):
                out[game, seat, COLLECTED_PLANE, where[games.position[game, own]]] = 1.0
