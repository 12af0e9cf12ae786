"""Compiled Bayes filter over the cell of one opponent that is not always seen.

Every game is filtered by itself, so that it does not depend on its batch. Tables over pairs of
cells lies as the distance tables do (`pair_index`): `sight` uint8 [own, other], and `chances`
float64 [other, own, action] (the opponent's own cell first).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined, summing
from pursuit.rules.captures import Duel, ends_duel
from pursuit.rules.distances import pair_index, table_distance
from pursuit.rules.layout import Games, World, world_of


@inlined
def predict(
    world: World, maze: int, before: int, now: int, chances: Any, duel: Duel, belief: Any, work: Any
) -> None:
    """Carry a belief one step on by the opponent's chances, to games without a capture."""
    size, first = world.num_cells[maze], world.first_cell[maze]
    for cell in range(size):
        work[cell] = 0.0
    for cell in range(size):
        if belief[cell] == 0.0:
            continue
        pair = pair_index(world, maze, cell, before)
        for action in range(chances.shape[1]):
            after = world.neighbors[first + cell, action]
            if not ends_duel(duel, before, now, cell, after):
                work[after] += belief[cell] * chances[pair, action]
    for cell in range(size):
        belief[cell] = work[cell]


@inlined
def hide_opponents(world: World, maze: int, own: int, sight: Any, belief: Any) -> bool:
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
    games: Games,
    seat: int,
    other: int,
    mazes: Any,
    sight: Any,
    chances: Any,
    settings: Any,
    rows: Any,
    belief: Any,
    known_at: Any,
    before: Any,
    work: Any,
) -> None:
    """Update the beliefs of all games by what is in view now.

    `settings` is (own role chases, chasers first, minimum start distance). `rows` [games] are the
    rows of the games in the agent's memory: `belief` [all games, cells] float64, the step
    `known_at` of that belief (-1: none), and the own cell `before`, both [all games] int32.
    `work` is float64 [cells].
    """
    own_chases, chasers_first, least = settings
    duel = Duel(own_chases, chasers_first)
    world = world_of(*mazes)
    for game in range(rows.shape[0]):
        row, maze = rows[game], np.int64(games.maze[game])
        own, theirs = np.int64(games.position[game, seat]), np.int64(games.position[game, other])
        mine, size = belief[row], world.num_cells[maze]
        in_view = (
            games.active[game, other] != 0 and sight[pair_index(world, maze, own, theirs)] != 0
        )
        if in_view:
            for cell in range(size):
                mine[cell] = 0.0
            mine[theirs] = 1.0
        elif known_at[row] < 0 or known_at[row] != games.steps[game]:
            if known_at[row] >= 0 and known_at[row] == games.steps[game] - 1:
                predict(world, maze, np.int64(before[row]), own, chances, duel, mine, work)
            else:
                for cell in range(size):
                    far = table_distance(world, maze, own, cell) >= least
                    mine[cell] = 1.0 if far else 0.0
            if not hide_opponents(world, maze, own, sight, mine):
                # The opponent does what it should not: it may be anywhere out of view.
                for cell in range(size):
                    mine[cell] = 1.0
                hide_opponents(world, maze, own, sight, mine)
        known_at[row] = games.steps[game]
        before[row] = own


@summing
def least_expected(
    first: Any, sizes: Any, belief: Any, worth: Any, most: float, work: Any, masks: Any
) -> None:
    """Fill `masks` [games] with the actions of least expected value under `belief` [games, cells].

    `worth` is [actions, pairs], `first` [games] the index of the pair (own cell, cell 0), `sizes`
    [games] the number of cells of the maze, and `work` is [actions]. Actions within the factor
    `most` of the least count as equal.
    """
    for game in range(masks.shape[0]):
        least, mask = np.inf, 0
        for action in range(work.shape[0]):
            total = 0.0
            for cell in range(sizes[game]):
                total += belief[game, cell] * worth[action, first[game] + cell]
            work[action], least = total, min(least, total)
        for action in range(work.shape[0]):
            mask |= (work[action] <= most * least) << action
        masks[game] = mask
