"""The planes of mazes and entities: their kernel, and what it needs of a task.

The planes of cells, walls and views depend on the maze, the agent's cell and the limit of its view
only. They are drawn once for each of these, when first needed, and then copied.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined
from pursuit.mazes.maze_arrays import grids_of
from pursuit.observations.custom import WINDOW, given_radius
from pursuit.rules.arrays import Array, Flags, Ints, Longs
from pursuit.rules.layout import Games
from pursuit.rules.visibility import (
    COLLECTED_PLANE,
    EXITS,
    GOALS_PLANE,
    IN_VIEW,
    IN_VIEW_PLANE,
    MAZE_PLANES,
    OTHER,
    PLANES,
    SELF,
    TEAM,
    has_collected,
    in_view,
    view_of,
)
from pursuit.tasks.task import Task

Codes = NDArray[np.uint8]
MOST_KEPT = 2**27
"""Largest size in bytes of the kept planes of all cells of a task; memory is used as they are
drawn."""
FEW = 8
"""Up to so many entities, or observing agents, entities are not sorted by row."""


@inlined
def cell_of(games: Games, game: int, entity: int) -> int:
    """The cell of an agent, goal or exit; -1 if it is gone."""
    num_agents, num_goals = np.uintp(games.position.shape[1]), np.uintp(games.goal.shape[1])
    if entity < num_agents:
        return games.position[game, entity] if games.active[game, entity] != 0 else -1
    if entity < num_agents + num_goals:
        return games.goal[game, entity - num_agents]
    return games.exit[game, entity - num_agents - num_goals]


@inlined
def sort_by_row(games: Games, game: int, places: Ints, ends: Ints, found: Ints) -> None:
    """Fill `found` [entities, 4] with (entity, cell, row, column) by row; those of row i end before
    index `ends[i]`."""
    number, num_entities = np.uintp(games.maze[game]), np.uintp(len(found))
    for row in range(np.uintp(len(ends))):
        ends[row] = 0
    for entity in range(num_entities):
        cell = cell_of(games, game, entity)
        if cell >= 0:
            ends[np.uintp(places[number, np.uintp(cell), 0])] += 1
    total = 0
    for row in range(np.uintp(len(ends))):
        total += ends[row]
        ends[row] = total - ends[row]
    for entity in range(num_entities):
        cell = cell_of(games, game, entity)
        if cell >= 0:
            down = places[number, np.uintp(cell), 0]
            index = np.uintp(ends[np.uintp(down)])
            ends[np.uintp(down)] += 1
            found[index, 0], found[index, 1], found[index, 2] = entity, cell, down
            found[index, 3] = places[number, np.uintp(cell), 1]


@inlined
def draw_maze(
    row: np.uintp, maze: np.uintp, view: int, top: int, left: int, height: int, width: int,
    hidden: bool, table: Flags | None, cells: Ints, places: Ints, out: Codes,
) -> None:  # fmt: skip
    """Draw the planes of walkable cells, walls and views into this row of `out` [rows, any].

    They begin with the cell (top, left).
    """
    out[row] = 0
    area = height * width
    for down in range(max(0, -top), min(height, cells.shape[1] - top)):
        for right in range(max(0, -left), min(width, cells.shape[2] - left)):
            cell, at = cells[maze, top + down, left + right], down * width + right
            if cell < 0:
                continue
            is_seen = in_view(table, view, cell)
            if table is not None and is_seen:
                out[row, at + (IN_VIEW_PLANE - MAZE_PLANES) * area] = 1
            if is_seen or not hidden:
                out[row, at] = 1
                for side in range(4):
                    out[row, at + (1 + side) * area] = (places[maze, cell, 2] >> side) & 1


@inlined
def place_of(
    layer: int, down: int, right: int, height: int, width: int, is_seen: bool, known: int
) -> int:
    """The index in an observation of a cell in a plane; `known` if it is not within.

    `known` is an index that holds 1 anyway: there is no branch, which would often be predicted
    wrongly.
    """
    inside = (down >= 0) & (down < height) & (right >= 0) & (right < width) & is_seen
    place: int = (np.intp(layer) * height + down) * width + right  # type: ignore[assignment]
    return place if inside else known


@compiled
def draw_planes(
    position: Ints, active: Ints, event: Ints, goal: Ints, steps: Ints, maze: Ints, exit_: Ints,
    table: Flags | None, begin: Longs | None, seats: Longs, layers: Codes, kinds: Longs,
    hidden: Flags, cells: Ints, places: Ints, radius: int, kept: bool, drawn: Flags,
    templates: Codes, ends: Ints, found: Ints, out: Array,
) -> None:  # fmt: skip
    """Fill `out` [games * seats, planes * height * width]; see `Planes` for the other arrays.

    `ends` and `found` are scratch memory of `sort_by_row`; without `ends` all entities are drawn.
    """
    games = Games(position, active, event, goal, steps, maze, exit_)
    height, width = cells.shape[1], cells.shape[2]
    if radius >= 0:
        height = width = 2 * radius + 1
    first, num_entities = MAZE_PLANES * height * width, np.uintp(layers.shape[1])
    for game in range(position.shape[0]):
        number = np.uintp(maze[game])
        if len(ends):
            sort_by_row(games, game, places, ends, found)
        for index in range(len(seats)):
            seat, row = np.uintp(seats[index]), np.uintp(game * len(seats) + index)
            cell, view = np.uintp(position[game, seat]), view_of(begin, games, game, seat)
            top, left = 0, 0
            if radius >= 0:
                top = places[number, cell, 0] - radius
                left = places[number, cell, 1] - radius
            chosen = np.uintp(0)
            if kept:
                chosen = np.uintp(kinds[seat] * cells.shape[0] + maze[game])
                if radius >= 0 or table is not None:
                    chosen = chosen * np.uintp(places.shape[1]) + cell
            if not drawn[chosen]:
                draw_maze(
                    chosen, number, view, top, left, height, width, hidden[seat], table, cells,
                    places, templates,
                )  # fmt: skip
                drawn[chosen] = kept
            for at in range(np.uintp(first)):
                out[row, at] = 0
            for at in range(np.uintp(templates.shape[1])):
                out[row, np.uintp(first) + at] = templates[chosen, at]
            own = (places[number, cell, 0] - top) * width + places[number, cell, 1] - left
            if has_collected(games, game, seat):
                out[row, np.uintp(COLLECTED_PLANE * height * width + own)] = 1
            own += first  # the own cell is walkable and visible: there is 1 already
            if not len(ends):
                for entity in range(num_entities):
                    other = cell_of(games, game, entity)
                    if other >= 0:
                        down = places[number, np.uintp(other), 0] - top
                        right = places[number, np.uintp(other), 1] - left
                        is_seen, layer = in_view(table, view, other), layers[seat, entity]
                        at = place_of(layer, down, right, height, width, is_seen, own)
                        out[row, np.uintp(at)] = 1
                continue
            begins = ends[np.uintp(top - 1)] if top > 0 else 0
            last = ends[np.uintp(min(len(ends), top + height) - 1)]
            for each in range(np.uintp(begins), np.uintp(last)):
                down, right = found[each, 2] - top, found[each, 3] - left
                is_seen = in_view(table, view, found[each, 1])
                layer = layers[seat, np.uintp(found[each, 0])]
                out[row, np.uintp(place_of(layer, down, right, height, width, is_seen, own))] = 1


def planes_of(task: Task) -> tuple[str, ...]:
    """The names of the planes of "planes" and "window": one more if views are limited, and one more
    if there are exits."""
    in_view = (IN_VIEW,) if task.sight.limited else ()
    return (*PLANES, *in_view, *((EXITS,) if task.most_exits else ()))


def radius_of(task: Task, encoding: str) -> int:
    """R of a window of 2R + 1 rows and columns.

    "window:R" gives it. For "window" it is the largest view radius of the task or, without one, the
    smallest R that shows the whole of every maze from each of its cells.

    Raises:
        ValueError: an invalid R.
    """
    given = given_radius(encoding)
    if given is not None:
        return given
    radii = [limit.view_radius for limit in task.sight.limits if limit.view_radius is not None]
    if radii:
        return given_radius(f"{WINDOW}:{max(radii)}") or 0
    return max(max(maze.height, maze.width) for maze in task.mazes) - 1


class Planes:
    """What draws "planes", or windows, of one task.

    Arrays of the kernel:

        cells, places   as of `grids_of`
        layers      [agents, entities] uint8, the plane of each agent, goal and exit
        kinds       [agents], the number of the limit of each agent's view among all limits
        templates   [kinds * mazes * cells, any] uint8, the planes from MAZE_PLANES on; without
                    windows and limited views one row for each maze, and if they would need more
                    than MOST_KEPT bytes a single row for all
        drawn       [rows of templates] bool, whether a row is complete

    Args:
        task: the task.
        radius: of the windows; None for the planes of whole mazes.

    Attributes:
        shape: of one observation.
    """

    def __init__(self, task: Task, radius: int | None) -> None:
        cells, places = grids_of(task.mazes)
        sight, names = task.sight, planes_of(task)
        sides = cells.shape[1:] if radius is None else (2 * radius + 1,) * 2
        self.shape = (len(names), *sides)
        roles = np.array(task.seat_roles)
        layers = np.where(roles[:, None] == roles, TEAM - SELF, OTHER - SELF)
        np.fill_diagonal(layers, 0)
        more = np.repeat([GOALS_PLANE, len(names) - 1], [task.num_goals, task.most_exits])
        layers = np.concatenate([layers, np.tile(more, (len(roles), 1))], axis=1)
        kinds = np.array([sight.limits.index(limit) for limit in sight.limits])
        rows = (kinds.max() + 1) * len(cells)
        rows *= task.max_cells if sight.limited or radius is not None else 1
        numbers = (len(names) - MAZE_PLANES) * math.prod(sides)
        kept = bool(rows * numbers <= MOST_KEPT)
        drawn = np.zeros(rows if kept else 1, dtype=bool)
        templates = np.empty((len(drawn), numbers), dtype=np.uint8)
        self._before: tuple[Any, Any] = sight.table, sight.begin
        self._seats = np.arange(len(roles))
        self._after: tuple[Any, ...] = (
            layers.astype(np.uint8), kinds, sight.hidden_maze, cells, places,
            -1 if radius is None else radius, kept, drawn, templates,
        )  # fmt: skip
        self._rows = 0 if radius is None or layers.shape[1] <= FEW else len(cells[0])
        self._found = layers.shape[1], 4

    def draw(self, games: Games, seats: slice, out: Array) -> None:
        """Fill `out` [games, seats, *shape], which is contiguous."""
        chosen = np.ascontiguousarray(self._seats[seats])
        ends = np.empty(self._rows if len(chosen) > FEW else 0, dtype=np.int32)
        found, flat = np.empty(self._found, dtype=np.int32), out.reshape(-1, math.prod(self.shape))
        rest = (*self._after, ends, found, flat)
        draw_planes(*games, *self._before, chosen, *rest)
