"""Moves towards or away from the nearest of several cells, by tables.

`greedy` has the layout of the distance tables: a bit mask of moves for [own cell, other cell].
"""

from __future__ import annotations

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Ints, Words
from pursuit.rules.distances import FAR, pair_index
from pursuit.rules.layout import World, stream_of
from pursuit.rules.randomness import draw_action

Index = int | np.uint64
"""Unsigned indices are faster in compiled code."""


@inlined
def towards_nearest(
    world: World, maze: int, own: int, cells: Ints, count: int, greedy: Ints
) -> int:
    """The greedy moves towards all nearest cells of `cells[:count]`; 0 if count is 0.

    The code has no branches, as the processor could not predict them.
    """
    row, mask, nearest = pair_index(world, maze, own, 0), np.int64(0), np.int64(FAR)
    for i in range(count):
        pair = np.uint64(row + np.int64(cells[np.uint64(i)]))
        distance, moves = np.int64(world.tables[pair]), np.int64(greedy[pair])
        farther, as_near = -np.int64(distance > nearest), -np.int64(distance >= nearest)
        mask = (mask & as_near) | (moves & ~farther)
        nearest = min(nearest, distance)
    return mask


@inlined
def away_from_nearest(
    world: World, maze: int, own: int, cells: Ints, count: int, greedy: Ints
) -> int:
    """The greedy moves away from the first nearest cell of `cells[:count]`; 0 if count is 0."""
    row, nearest = pair_index(world, maze, own, 0), np.int64(2**62)
    for i in range(count):
        cell = np.int64(cells[np.uint64(i)])
        distance = np.int64(world.tables[np.uint64(pair_index(world, maze, cell, own))])
        nearest = min(nearest, (distance << 32) | i)
    if count == 0:
        return 0
    threat = np.int64(cells[np.uint64(nearest & 0xFFFFFFFF)])
    return np.int64(greedy[np.uint64(row + threat)])


@inlined
def write_action(
    actions: Ints, game: Index, column: Index, mask: int, every: int, epsilon: float,
    default: float, empty: int, few: bool, streams: Words, seat: Index,
) -> None:  # fmt: skip
    """Write the action of an agent: a greedy move or, with probability epsilon, any move."""
    share = default if np.isnan(epsilon) else epsilon
    greedy = every if mask == 0 else mask
    stream = np.uint64(stream_of(seat))
    actions[game, column] = draw_action(greedy, every, share, empty, few, streams[game], stream)
