"""Path distances between cells: from tables, or by search if a maze is too large for a table.

The distance of cells a and b of maze m is `tables[table[m] + a * num_cells[m] + b]`; only
`table_distance` uses this layout.
"""

from __future__ import annotations

import numpy as np

from pursuit.compilation.compiled import allocating, compiled, inlined, subroutine
from pursuit.rules.arrays import Ints
from pursuit.rules.layout import (
    COLUMN,
    FIRST_CELL,
    NUM_CELLS,
    ROW,
    TABLE,
    UNREACHABLE,
    Search,
    World,
    stay_of,
)

NO_PATH = 65535
"""UNREACHABLE in a table of uint16."""
FAR = 2**30


@inlined
def moves_of(neighbors: Ints) -> range:
    """The actions that are moves: four in a maze, as many as the largest degree in a graph."""
    return range(stay_of(neighbors))


@compiled
def breadth_first(neighbors: Ints, origin: int, distances: Ints, queue: Ints) -> int:
    """Fill `distances` (all UNREACHABLE) from `origin`; return the number of reached cells."""
    distances[origin] = 0
    queue[0] = origin
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        for action in range(neighbors.shape[1] - 1):
            after = neighbors[cell, action]
            if distances[after] == UNREACHABLE:
                distances[after] = distances[cell] + 1
                queue[tail] = after
                tail += 1
    return tail


@allocating
def all_distances(neighbors: Ints, table: Ints) -> None:
    """Fill the [cells, cells] `table` by one breadth-first search per row."""
    queue = np.empty(table.shape[0], dtype=np.int32)
    for origin in range(table.shape[0]):
        table[origin, :] = UNREACHABLE
        breadth_first(neighbors, origin, table[origin], queue)


@allocating
def longest_distance(neighbors: Ints) -> int:
    """The largest finite distance between two cells, in memory linear in the cells."""
    size = neighbors.shape[0]
    queue = np.empty(size, dtype=np.int32)
    distances = np.empty(size, dtype=np.int32)
    longest = 0
    for origin in range(size):
        distances[:] = UNREACHABLE
        reached = breadth_first(neighbors, origin, distances, queue)
        longest = max(longest, distances[queue[reached - 1]])
    return longest


@subroutine
def search_within(
    world: World, maze: int, origin: int, limit: int, target: int, search: Search
) -> int:
    """Breadth-first search from `origin` up to `limit` steps, ended early at `target`.

    Returns the number of cells reached. The caller must call `forget` afterwards.
    """
    first = world.mazes[FIRST_CELL, maze]
    search.distance[origin] = 0
    search.queue[0] = origin
    head, tail = 0, 1
    while head < tail:
        cell = search.queue[head]
        head += 1
        if cell == target or search.distance[cell] == limit:
            break
        for action in moves_of(world.neighbors):
            after = world.neighbors[first + cell, action]
            if search.distance[after] < 0:
                search.distance[after] = search.distance[cell] + 1
                search.queue[tail] = after
                tail += 1
    return tail


@subroutine
def forget(search: Search, reached: int) -> None:
    """Reset the distances that a search of `reached` cells wrote."""
    for i in range(reached):
        search.distance[search.queue[i]] = -1


@inlined
def has_table(world: World, maze: int) -> bool:
    """Whether the maze has a table of distances; large mazes have none."""
    return world.mazes[TABLE, maze] >= 0


@inlined
def pair_index(world: World, maze: int, a: int, b: int) -> int:
    """The index of the pair of cells (a, b) in the tables."""
    return world.mazes[TABLE, maze] + a * world.mazes[NUM_CELLS, maze] + b


@inlined
def table_distance(world: World, maze: int, a: int, b: int) -> int:
    """Steps between cells a and b of a maze that has a table."""
    return np.int64(world.tables[pair_index(world, maze, a, b)])


@inlined
def distance_within(world: World, search: Search, maze: int, a: int, b: int, limit: int) -> int:
    """Steps between cells a and b, or limit + 1 if there are more (or no path)."""
    if has_table(world, maze):
        steps = table_distance(world, maze, a, b)
        return limit + 1 if steps == NO_PATH else min(steps, limit + 1)
    return searched_distance(world, search, maze, a, b, limit)


@subroutine
def searched_distance(world: World, search: Search, maze: int, a: int, b: int, limit: int) -> int:
    """`distance_within` by search, for mazes without a table."""
    if manhattan(world.facts, world.mazes[FIRST_CELL, maze], a, b) > limit:
        return limit + 1
    reached = search_within(world, maze, a, limit, b, search)
    found = search.distance[b]
    forget(search, reached)
    return found if 0 <= found <= limit else limit + 1


@inlined
def place_of(first_cell: int, cell: int) -> np.uint64:
    """The index in the arrays of the world of a cell of the maze that begins at `first_cell`.

    It is unsigned, as compiled code checks signed indices for negative values.
    """
    return np.uint64(first_cell + cell)


@inlined
def manhattan(facts: Ints, first_cell: int, a: int, b: int) -> int:
    """The Manhattan distance between cells of the maze that begins at `first_cell`."""
    a, b = place_of(first_cell, a), place_of(first_cell, b)
    return abs(facts[ROW, a] - facts[ROW, b]) + abs(facts[COLUMN, a] - facts[COLUMN, b])


@inlined
def begin_field(field: Search, owner: Ints, cells: Ints, count: int) -> int:
    """Start a search from all of `cells[:count]`; return the number of different cells.

    For every cell reached, `owner` is the index in the list of the first source nearest to it.
    """
    tail = 0
    for i in range(count):
        cell = cells[i]
        if field.distance[cell] < 0:
            field.distance[cell] = 0
            owner[cell] = i
            field.queue[tail] = cell
            tail += 1
    return tail


@subroutine
def spread_field(
    world: World, maze: int, field: Search, owner: Ints, own: int, limit: int, head: int, tail: int
) -> tuple[int, int]:
    """Continue a search until it reaches `own` or `limit` steps; return the ends of its queue.

    `owner` is the first of the nearest sources only if `own` is -1 (the search ends at the limit),
    as it is final for a cell once all nearer cells have been expanded.
    """
    first_cell = world.mazes[FIRST_CELL, maze]
    while head < tail and (own < 0 or field.distance[own] < 0):
        cell = field.queue[head]
        after_steps = field.distance[cell] + 1
        if after_steps > limit:
            break
        head += 1
        for action in moves_of(world.neighbors):
            after = world.neighbors[first_cell + cell, action]
            if field.distance[after] < 0:
                field.distance[after] = after_steps
                owner[after] = owner[cell]
                field.queue[tail] = after
                tail += 1
            elif field.distance[after] == after_steps and owner[cell] < owner[after]:
                owner[after] = owner[cell]
    return head, tail


@inlined
def moves_down(world: World, maze: int, field: Search, own: int) -> int:
    """The mask of moves towards the sources of a search that has reached `own`, or 0."""
    mask, steps = 0, field.distance[own]
    if steps > 0:
        for action in moves_of(world.neighbors):
            after = world.neighbors[world.mazes[FIRST_CELL, maze] + own, action]
            if field.distance[after] == steps - 1:
                mask |= 1 << action
    return mask
