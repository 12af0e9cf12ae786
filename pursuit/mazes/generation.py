"""Maze generators; `tools/shipped_mazes.py` makes the shipped mazes and suites with them.

A grid of H×W cells has (H-1)W + H(W-1) inner walls. The generators work on one flat bool array
`passages` of that length, True where a wall is open: first the walls south of the cells, row by
row, then the walls east of the cells. Cells are numbered row by row.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import allocating, compiled, inlined
from pursuit.mazes.graph_generation import graph_drawing
from pursuit.mazes.maze import Maze
from pursuit.memory import check_memory
from pursuit.rules import EAST, NORTH, SOUTH, next_below
from pursuit.rules.arrays import Flags, Longs, Words
from pursuit.validation import check_bool, is_int, is_number, one_of, whole

MAX_CELLS = 4_000_000
"""The largest maze that can be generated; 2000×2000 cells take some seconds and 500 MB."""

BYTES_PER_CELL = 100
"""Memory per cell during generation: 70 bytes measured, plus the arrays of the algorithms."""

OUTSIDE, FRONTIER, INSIDE = range(3)

# -- the grid --------------------------------------------------------------------------------------


@inlined
def passage_of(cell: int, action: int, height: int, width: int) -> int:
    """The index in `passages` of the wall in that direction; -1 at the border."""
    row, column = cell // width, cell % width
    first_east = (height - 1) * width
    if action == NORTH:
        return cell - width if row > 0 else -1
    if action == SOUTH:
        return cell if row < height - 1 else -1
    if action == EAST:
        return first_east + cell - row if column < width - 1 else -1
    return first_east + cell - row - 1 if column > 0 else -1


@inlined
def cell_after(cell: int, action: int, width: int) -> int:
    """The next cell in that direction, ignoring walls; undefined at the border."""
    if action == NORTH:
        return cell - width
    if action == SOUTH:
        return cell + width
    return cell + 1 if action == EAST else cell - 1


@compiled
def degree(cell: int, height: int, width: int, passages: Flags) -> int:
    """The number of open sides of the cell."""
    count = 0
    for action in range(4):
        passage = passage_of(cell, action, height, width)
        count += passage >= 0 and passages[passage]
    return count


@inlined
def random_action(
    cell: int, states: NDArray[np.uint8], wanted: int, height: int, width: int, streams: Words
) -> int:
    """A uniformly random direction to a neighbour with the wanted state; -1 if there is none."""
    chosen, count = -1, 0
    for action in range(4):
        if passage_of(cell, action, height, width) < 0:
            continue
        if states[cell_after(cell, action, width)] == wanted:
            count += 1
            if next_below(streams, 0, count) == 0:
                chosen = action
    return chosen


# -- algorithms ------------------------------------------------------------------------------------


@allocating
def prim(height: int, width: int, streams: Words, passages: Flags) -> None:
    """Randomised Prim: connect a random cell of the frontier to a random neighbour in the maze.

    Many short dead ends.
    """
    size = height * width
    states = np.zeros(size, dtype=np.uint8)
    frontier = np.empty(size, dtype=np.int64)
    frontier[0] = next_below(streams, 0, size)
    count = 1
    while count > 0:
        choice = next_below(streams, 0, count)
        cell = frontier[choice]
        count -= 1
        frontier[choice] = frontier[count]
        to_inside = random_action(cell, states, INSIDE, height, width, streams)
        if to_inside >= 0:  # the first cell has no neighbour in the maze
            passages[passage_of(cell, to_inside, height, width)] = True
        states[cell] = INSIDE
        for action in range(4):
            if passage_of(cell, action, height, width) >= 0:
                after = cell_after(cell, action, width)
                if states[after] == OUTSIDE:
                    states[after] = FRONTIER
                    frontier[count] = after
                    count += 1


@allocating
def backtracker(height: int, width: int, streams: Words, passages: Flags) -> None:
    """Randomised depth-first search: move to random unvisited neighbours and backtrack.

    Long winding corridors.
    """
    size = height * width
    states = np.zeros(size, dtype=np.uint8)
    path = np.empty(size, dtype=np.int64)
    path[0] = next_below(streams, 0, size)
    states[path[0]] = INSIDE
    length = 1
    while length > 0:
        cell = path[length - 1]
        action = random_action(cell, states, OUTSIDE, height, width, streams)
        if action < 0:
            length -= 1
            continue
        passages[passage_of(cell, action, height, width)] = True
        path[length] = cell_after(cell, action, width)
        states[path[length]] = INSIDE
        length += 1


@allocating
def wilson(height: int, width: int, streams: Words, passages: Flags) -> None:
    """Loop-erased random walks: a spanning tree drawn uniformly from all of them. Wilson (1996)."""
    size = height * width
    inside = np.zeros(size, dtype=np.bool_)
    last_exit = np.empty(size, dtype=np.int8)
    inside[next_below(streams, 0, size)] = True
    for origin in range(size):
        cell = origin
        while not inside[cell]:
            action = next_below(streams, 0, 4)
            if passage_of(cell, action, height, width) >= 0:
                last_exit[cell] = action
                cell = cell_after(cell, action, width)
        # Following the last exits retraces the walk without its loops.
        cell = origin
        while not inside[cell]:
            inside[cell] = True
            passages[passage_of(cell, last_exit[cell], height, width)] = True
            cell = cell_after(cell, last_exit[cell], width)


def open_grid(height: int, width: int, streams: Words, passages: Flags) -> None:
    """No inner walls at all."""
    passages[:] = True


@compiled
def braid(height: int, width: int, order: Longs, streams: Words, passages: Flags) -> None:
    """Open one wall of every dead end, visiting the cells in this order.

    The wall is drawn from those to another dead end, or from all walls if there is none.
    """
    for cell in order:
        if degree(cell, height, width, passages) != 1:
            continue
        for dead_ends_only in (True, False):
            chosen, count = -1, 0
            for action in range(4):
                wall = passage_of(cell, action, height, width)
                if wall < 0 or passages[wall]:
                    continue
                after = cell_after(cell, action, width)
                if not dead_ends_only or degree(after, height, width, passages) == 1:
                    count += 1
                    if next_below(streams, 0, count) == 0:
                        chosen = wall
            if chosen >= 0:
                passages[chosen] = True
                break


ALGORITHMS: dict[str, Callable[[int, int, Words, Flags], None]] = {
    "prim": prim,
    "backtracker": backtracker,
    "wilson": wilson,
    "open": open_grid,
}


def generate_maze(
    algorithm: str,
    height: int,
    width: int | None = None,
    loops: float = 0.0,
    no_dead_ends: bool = False,
    seed: int | np.random.Generator = 0,
    name: str | None = None,
) -> Maze:
    """A random connected maze without marks or blocked cells.

    Args:
        algorithm: `"prim"` (randomised Prim), `"backtracker"` (depth-first), `"wilson"` (uniform
            over all spanning trees) or `"open"` (no inner walls). The first three make trees.
        height: rows of cells.
        width: columns of cells; default: `height`.
        loops: fraction, 0 to 1, of the remaining inner walls to remove (rounded to whole walls,
            drawn uniformly). In a tree each removed wall makes one independent cycle.
        no_dead_ends: finally open walls until no cell has exactly one open side.
        seed: an int, or a generator to draw from.
        name: the name of the maze; default: algorithm and size, `"prim-9x9"`.

    Raises:
        ValueError: an unknown algorithm, a size below 1, above MAX_CELLS cells or beyond the
            available memory, loops outside 0 to 1, a negative seed, or no_dead_ends
            with a single row or column of cells.
    """
    one_of("algorithm", algorithm, tuple(ALGORITHMS))
    height = whole("height", height, 1)
    width = height if width is None else whole("width", width, 1)
    cells = height * width
    if cells > MAX_CELLS:
        raise ValueError(
            f"{height}x{width} is {cells} cells; they need {cells * BYTES_PER_CELL:,} bytes, and a "
            f"generated maze has at most {MAX_CELLS}: make it smaller"
        )
    check_memory(f"{height}x{width} cells", cells * BYTES_PER_CELL, "make it smaller")
    check_bool("no_dead_ends", no_dead_ends)
    if not is_number(loops) or not 0 <= loops <= 1:
        raise ValueError(
            f"loops {loops!r}; it is a fraction of the inner walls: give a number from 0 (a tree "
            "remains a tree) to 1 (no inner walls)"
        )
    if no_dead_ends and min(height, width) == 1 < max(height, width):
        raise ValueError(
            f"no_dead_ends in {height}x{width} cells; both ends of a single row or column are dead "
            "ends: give height and width of 2 or more, or leave no_dead_ends out"
        )
    if not isinstance(seed, np.random.Generator) and (not is_int(seed) or seed < 0):
        raise ValueError(f"seed {seed!r}; give an int of 0 or more, or a numpy Generator")
    rng = np.random.default_rng(seed)
    streams = rng.integers(2**64, size=1, dtype=np.uint64)
    num_south = (height - 1) * width
    passages = np.zeros(num_south + height * (width - 1), dtype=np.bool_)
    ALGORITHMS[algorithm](height, width, streams, passages)
    walls = np.flatnonzero(~passages)
    passages[rng.choice(walls, size=round(loops * walls.size), replace=False)] = True
    if no_dead_ends:
        braid(height, width, rng.permutation(height * width), streams, passages)
    return Maze(
        np.ones((height, width), dtype=np.bool_),
        passages[:num_south].reshape(height - 1, width),
        passages[num_south:].reshape(height, width - 1),
        name=f"{algorithm}-{height}x{width}" if name is None else name,
    )


def generate_graph(kind: str, height: int = 8, width: int = 8, seed: int = 0) -> Maze:
    """Generate a graph of height × width cells.

    - "eight": a grid with moves in eight directions;
    - "hexagonal": hexagons in rows, with six neighbors;
    - "torus": a grid with connected opposite borders;
    - "geometric": random points in the unit square, connected up to the least distance for which
      the graph is connected;
    - "roads": crossings of a grid of streets, of which a quarter is missing and a seventh is
      one-way, some diagonal streets, and some streets that take two steps (as many cells more).

    Args:
        kind: one of these.
        height, width: rows and columns of cells, at least 3.
        seed: of "geometric" and "roads".

    Raises:
        ValueError: an unknown kind, or a size below 3.
    """
    name = f"{kind}-{height}x{width}" + (f"-{seed}" if kind in ("geometric", "roads") else "")
    return Maze.from_drawing(graph_drawing(kind, height, width, seed, name), name)
