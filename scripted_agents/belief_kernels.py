"""Compiled Bayes filter over the cell of one opponent that is not always seen, and who acts by it.

Every game is filtered by itself, so that it does not depend on its batch. What is asked of pairs of
cells lies as the distance tables do (`pair_index`): `sight` uint8 [own, other], `chances` float64
[other, own, action] (the opponent's own cell first), `worth` float64 [own, other, 5 actions] and
`best` [own, other], actions as a bit mask.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled, inlined
from pursuit.rules.distances import pair_index, table_distance
from pursuit.rules.layout import STAY, World, stream_of, world_of
from pursuit.rules.randomness import draw_action
from pursuit.rules.step import legal_moves

AT_ONCE, OWN_FIRST, OTHER_FIRST = range(3)
"""Who moves first, and so when two that meet are caught, seen from whoever believes."""

EQUALLY_LIKELY = 1e-9
"""Relative difference below which two cells count as equally likely."""

EQUALLY_GOOD = 1e-8
"""Relative difference below which two actions count as equally good."""


@inlined
def predict(
    world: World, maze: int, before: int, now: int, chances: Any, order: int, belief: Any, room: Any
) -> None:
    """Carry a belief one step on by the opponent's chances, to games in which nobody was captured.

    One's own cell `now` is in view, so what comes to it is taken out with all that is seen.
    """
    size, first = world.num_cells[maze], world.first_cell[maze]
    for cell in range(size):
        room[cell] = 0.0
    for cell in range(size):
        if belief[cell] == 0.0 or (cell == now and order == OWN_FIRST):
            continue
        pair = pair_index(world, maze, cell, before)
        for action in range(chances.shape[1]):
            after = world.neighbors[first + cell, action]
            if cell != now or after != before or order != AT_ONCE:  # else they would have swapped
                room[after] += belief[cell] * chances[pair, action]
    if order == OTHER_FIRST:
        room[before] = 0.0
    for cell in range(size):
        belief[cell] = room[cell]


@inlined
def see_nobody(world: World, maze: int, own: int, sight: Any, belief: Any) -> bool:
    """Take what is in view out of a belief, and norm it; False where nothing is left of it."""
    total = 0.0
    for cell in range(world.num_cells[maze]):
        if sight[pair_index(world, maze, own, cell)]:
            belief[cell] = 0.0
        total += belief[cell]
    if total <= 0.0:
        return False
    for cell in range(world.num_cells[maze]):
        belief[cell] /= total
    return True


@compiled
def update_beliefs(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    seat: int,
    other: int,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    sight: Any,
    chances: Any,
    settings: Any,
    rows: Any,
    belief: Any,
    known_at: Any,
    before: Any,
    room: Any,
) -> None:
    """Bring the beliefs of all games to what is in view now.

    `settings` is (order, least distance of a start). `rows` [games] are the games' rows of what is
    remembered: `belief` [all games, cells] float64, the step `known_at` which it held (-1: nothing
    is known) and the own cell `before`, both [all games] int32. `room` is float64 [cells].
    """
    order, least = settings
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(rows.shape[0]):
        row, maze = rows[game], np.int64(maze_of[game])
        own, theirs = np.int64(position[game, seat]), np.int64(position[game, other])
        mine, size = belief[row], world.num_cells[maze]
        in_view = active[game, other] != 0 and sight[pair_index(world, maze, own, theirs)] != 0
        if in_view:
            for cell in range(size):
                mine[cell] = 0.0
            mine[theirs] = 1.0
        elif known_at[row] < 0 or known_at[row] != steps[game]:
            if known_at[row] >= 0 and known_at[row] == steps[game] - 1:
                predict(world, maze, np.int64(before[row]), own, chances, order, mine, room)
            else:
                for cell in range(size):
                    far = table_distance(world, maze, own, cell) >= least
                    mine[cell] = 1.0 if far else 0.0
            if not see_nobody(world, maze, own, sight, mine):
                # The opponent does what it should not: it may be anywhere out of view.
                for cell in range(size):
                    mine[cell] = 1.0
                see_nobody(world, maze, own, sight, mine)
        known_at[row] = steps[game]
        before[row] = own


@inlined
def least_expected(world: World, maze: int, own: int, belief: Any, worth: Any) -> int:
    """The actions of least expected worth, as a mask."""
    north, south, east, west, stay = 0.0, 0.0, 0.0, 0.0, 0.0
    first = pair_index(world, maze, own, 0)
    for cell in range(world.num_cells[maze]):
        share = belief[cell]
        if share > 0.0:
            north += share * worth[first + cell, 0]
            south += share * worth[first + cell, 1]
            east += share * worth[first + cell, 2]
            west += share * worth[first + cell, 3]
            stay += share * worth[first + cell, 4]
    most = min(north, south, east, west, stay) * (1.0 + EQUALLY_GOOD)
    mask = (north <= most) | (south <= most) << 1 | (east <= most) << 2 | (west <= most) << 3
    return np.int64(mask | (stay <= most) << 4)


@inlined
def against_most_likely(world: World, maze: int, own: int, belief: Any, best: Any) -> int:
    """The best actions against the cells that are most likely, as a mask."""
    highest = 0.0
    for cell in range(world.num_cells[maze]):
        highest = max(highest, belief[cell])
    mask = 0
    for cell in range(world.num_cells[maze]):
        if belief[cell] > 0.0 and belief[cell] >= highest * (1.0 - EQUALLY_LIKELY):
            mask |= np.int64(best[pair_index(world, maze, own, cell)])
    return mask


@compiled
def act_on_beliefs(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    streams: Any,
    epsilon_of: Any,
    seat: int,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    rows: Any,
    belief: Any,
    worth: Any,
    best: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games]; `settings` is (epsilon, stay action, by the expected worth).

    An epsilon of NaN in the game means that of the settings.
    """
    default, stay_action, expected = settings
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(rows.shape[0]):
        maze, own, mine = (
            np.int64(maze_of[game]),
            np.int64(position[game, seat]),
            belief[rows[game]],
        )
        if expected:
            mask = least_expected(world, maze, own, mine, worth)
            if not stay_action:  # nothing is expected in games that are over
                mask &= ~(1 << STAY)
        else:
            mask = against_most_likely(world, maze, own, mine, best)
        every = legal_moves(world, maze, own)
        if mask == 0:
            mask = every
        epsilon = default if np.isnan(epsilon_of[game, seat]) else epsilon_of[game, seat]
        actions[game] = draw_action(
            mask, every, epsilon, stay_action, streams[game], stream_of(seat)
        )
