"""Compiled Bayes filter over the cell of one opponent that is not always visible.

Games are filtered separately, so results do not depend on the batch. Tables over pairs of cells
have the layout of the distance tables (`pair_index`): `visible` uint8 [own, other], and `chances`
float64 [other, own, action], the action probabilities of the opponent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined, summing
from pursuit.rules.captures import Duel, ends_duel
from pursuit.rules.distances import pair_index, table_distance
from pursuit.rules.layout import FIRST_CELL, NUM_CELLS, Games, World


@inlined
def predict(
    world: World, maze: int, before: int, now: int, chances: Any, duel: Duel, belief: Any, work: Any
) -> None:
    """Predict a belief one step ahead by the opponent's table, given that there is no capture."""
    size, first = world.mazes[NUM_CELLS, maze], world.mazes[FIRST_CELL, maze]
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
def remove_visible(world: World, maze: int, own: int, visible: Any, belief: Any) -> bool:
    """Remove visible cells from a belief and normalise it; False if the belief becomes 0."""
    total = 0.0
    for cell in range(world.mazes[NUM_CELLS, maze]):
        if visible[pair_index(world, maze, own, cell)]:
            belief[cell] = 0.0
        total += belief[cell]
    if total <= 0.0:
        return False
    for cell in range(world.mazes[NUM_CELLS, maze]):
        belief[cell] /= total
    return True


@compiled
def update_beliefs(
    games: Games, seat: int, other: int, world: World, visible: Any, chances: Any, settings: Any,
    rows: Any, belief: Any, known_at: Any, before: Any, work: Any,
) -> None:  # fmt: skip
    """Update the beliefs of all games by the current observation.

    `settings` is (own role chases, chasers first, minimum start distance). `rows` [games] are the
    rows of the games in the agent's memory: `belief` [all games, cells] float64, the step
    `known_at` of that belief (-1: none), and the own cell `before` in it, both [all games] int32.
    `work` is float64 [cells], scratch memory.
    """
    own_chases, chasers_first, least = settings
    duel = Duel(own_chases, chasers_first)
    for game in range(rows.shape[0]):
        row, maze = rows[game], np.int64(games.maze[game])
        own, theirs = np.int64(games.position[game, seat]), np.int64(games.position[game, other])
        mine, size = belief[row], world.mazes[NUM_CELLS, maze]
        in_view = (
            games.active[game, other] != 0 and visible[pair_index(world, maze, own, theirs)] != 0
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
                    chaser, evader = (own, cell) if own_chases else (cell, own)
                    far = table_distance(world, maze, chaser, evader) >= least
                    mine[cell] = 1.0 if far else 0.0
            if not remove_visible(world, maze, own, visible, mine):
                # The opponent deviates from its table: it may be in any cell out of view.
                for cell in range(size):
                    mine[cell] = 1.0
                remove_visible(world, maze, own, visible, mine)
        known_at[row] = games.steps[game]
        before[row] = own


@summing
def least_expected(
    first: Any, sizes: Any, belief: Any, q_values: Any, most: float, work: Any, masks: Any
) -> None:
    """Fill `masks` [games] with the actions of least expected value under `belief` [games, cells].

    `q_values` is [actions, pairs], `first` [games] the index of the pair (own cell, cell 0),
    `sizes` [games] the number of cells of the maze, and `work` [actions] scratch memory. Actions
    within the factor `most` of the least value count as equally good.
    """
    for game in range(masks.shape[0]):
        least, mask = np.inf, 0
        for action in range(work.shape[0]):
            total = 0.0
            for cell in range(sizes[game]):
                total += belief[game, cell] * q_values[action, first[game] + cell]
            work[action], least = total, min(least, total)
        for action in range(work.shape[0]):
            mask |= (work[action] <= most * least) << action
        masks[game] = mask
