"""Kernels that write the built-in encodings.

`list_entities` reads the games. For grids its result, `seen` [games, agents, entities + 1] int32,
holds the cell of every entity: -1 if it is gone or out of view. The last entry is the agent's own
cell if it collected a goal in the last step, else -1. `pursuit.observations.planes` has the kernel
of planes and windows.

`table` and `begin` describe limited views (`pursuit.rules.visibility`); both are None if no view is
limited.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.arrays import Array, Flags, Ints, Longs
from pursuit.rules.layout import Games
from pursuit.rules.visibility import (
    UNSEEN,
    has_collected,
    in_view,
    place_in_view,
    rank_of,
    view_of,
)

Codes = NDArray[np.uint8]


@inlined
def write_place(
    out: Array, game: int, seat: int, entity: int, place: int, shown: bool, gone: int | None
) -> None:
    """Write the place of an entity; if `gone` is None, mark the place by 1."""
    if gone is None:
        if shown:
            out[game, seat, place] = 1.0
    else:
        out[game, seat, entity] = place if shown else gone


@compiled
def list_entities(
    position: Ints, active: Ints, event: Ints, goal: Ints, steps: Ints, maze: Ints, exit_: Ints,
    table: Flags | None, begin: Longs | None, order: Longs, first: int, size: int,
    gone: int | None, out: Array,
) -> None:  # fmt: skip
    """Fill `out` [games, seats, entities + 1] with first + size * entity + cell, or `gone`.

    Where `gone` is None, these are the places of the ones of `out` [games, seats, any], else of 0.
    `order` [seats, agents] has the agents in the order of entities.
    """
    games = Games(position, active, event, goal, steps, maze, exit_)
    num_agents, num_goals, num_exits = position.shape[1], goal.shape[1], exit_.shape[1]
    last = num_agents + num_goals + num_exits
    if gone is None:
        out[:] = 0.0
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            own = np.uintp(order[seat, 0])  # unsigned: faster
            view = view_of(begin, games, game, own)
            for entity in range(num_agents):
                agent = np.uintp(order[seat, entity])
                cell = games.position[game, agent]
                shown = (games.active[game, agent] != 0) & in_view(table, view, cell)
                write_place(out, game, seat, entity, first + size * entity + cell, shown, gone)
            for number in range(num_goals):
                cell = place_in_view(goal, table, view, game, number)
                entity = num_agents + rank_of(goal, table, view, game, number)
                write_place(out, game, seat, entity, first + size * entity + cell, cell >= 0, gone)
            for number in range(num_exits):
                cell = place_in_view(exit_, table, view, game, number)
                entity = num_agents + num_goals + rank_of(exit_, table, view, game, number)
                write_place(out, game, seat, entity, first + size * entity + cell, cell >= 0, gone)
            place = first + size * last + games.position[game, own]
            write_place(out, game, seat, last, place, has_collected(games, game, own), gone)


@compiled
def draw_codes(seen: Ints, maze: Ints, codes: Longs, places: Longs, out: Codes) -> None:
    """Write the code of every entity into `out` [games, seats, flattened grid].

    `codes` [seats, entities, 2] has (entity, code) in the order of drawing; `places` [mazes, cells]
    is the index of each cell in the grid.
    """
    for game in range(seen.shape[0]):
        for seat in range(seen.shape[1]):
            for turn in range(codes.shape[1]):
                entity, code = codes[seat, turn]
                cell = seen[game, seat, entity]
                if cell >= 0:
                    out[game, seat, places[maze[game], cell]] = code


@compiled
def hide_grid(
    position: Ints, active: Ints, event: Ints, goal: Ints, steps: Ints, maze: Ints, exit_: Ints,
    table: Flags, begin: Longs, order: Longs, hidden: Flags, places: Longs, background: Codes,
    columns: int, reach: int, out: Codes,
) -> None:  # fmt: skip
    """Leave in `out` [games, seats, flattened grid] of the maze only what is within view.

    `hidden` is [seats] bool (the agents with a hidden maze), `background` [mazes, flattened grid],
    `columns` the width of a row of it, and `reach` is 1 if the grid has walls between cells, which
    are visible with the cells beside them.
    """
    games = Games(position, active, event, goal, steps, maze, exit_)
    for game in range(out.shape[0]):
        number = maze[game]
        for seat in range(out.shape[1]):
            if not hidden[seat]:
                continue
            view = view_of(begin, games, game, order[seat, 0])
            for place in range(out.shape[2]):
                out[game, seat, place] = UNSEEN
            for cell in range(begin[begin.shape[0] - 1, number]):
                if in_view(table, view, cell):
                    for down in range(-reach, reach + 1):
                        for right in range(-reach, reach + 1):
                            place = places[number, cell] + down * columns + right
                            out[game, seat, place] = background[number, place]
