"""Compiled kernels of the turn-based game: sets of evader cells as bits, one set for every team.

A *team* is the index of the cells of all chasers, the last chaser varying fastest. Bit
`row * width + column` of a set [words] uint64 is that position in the grid, so that a move of all
evaders is a shift. In a graph it is the number of the cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled


@compiled
def trap(winning: Any, trapped: Any, chances: Any, offsets: Any) -> None:
    """Positions in which the evader is to move and loses: all of its moves lead to `winning`.

    Args:
        winning: [teams, words], positions with the chasers to move that they win.
        trapped: [teams, words], output.
        chances: [moves, words], the grid positions where each move is possible.
        offsets: [moves] int64, the offset of each move in the grid.
    """
    teams, words = winning.shape
    for team in range(teams):
        for word in range(words):
            bad = np.uint64(0)
            for move in range(len(offsets)):
                offset = offsets[move]
                # Bit p of the shifted set is bit p + offset of the positions that are not winning.
                whole, part = offset // 64, np.uint64(offset % 64)
                here, there = word + whole, word + whole + 1
                bits = np.uint64(0)
                if 0 <= here < words:
                    bits = ~winning[team, here] >> part
                if part != np.uint64(0) and 0 <= there < words:
                    bits |= ~winning[team, there] << (np.uint64(64) - part)
                bad |= bits & chances[move, word]
            trapped[team, word] = ~bad


@compiled
def trap_in_graph(winning: Any, trapped: Any, neighbors: Any) -> None:
    """`trap` in a graph with `neighbors` [cells, actions]."""
    for team in range(winning.shape[0]):
        trapped[team, :] = np.uint64(0)
        for cell in range(neighbors.shape[0]):
            lost = True
            for after in neighbors[cell]:
                lost &= (winning[team, after >> 6] >> np.uint64(after & 63)) & np.uint64(1) != 0
            if lost:
                trapped[team, cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)


@compiled
def add_captures(trapped: Any, taken: Any, num_chasers: int) -> None:
    """Add the positions in which the evader is in the cell of a chaser; `taken` [cells, words] is
    the position of every cell as a set."""
    size = taken.shape[0]
    for team in range(trapped.shape[0]):
        number = team
        for _ in range(num_chasers):
            for word in range(trapped.shape[1]):
                trapped[team, word] |= taken[number % size, word]
            number //= size


@compiled
def join(source: Any, target: Any, neighbors: Any, useful: Any, scale: int) -> None:
    """target[team] = the union of source[team'] over the moves of one chaser (stride `scale`)."""
    size, actions = neighbors.shape
    for team in range(source.shape[0]):
        cell = team // scale % size
        target[team, :] = np.uint64(0)
        for action in range(actions):
            if useful[cell, action]:
                following = team + (neighbors[cell, action] - cell) * scale
                for word in range(source.shape[1]):
                    target[team, word] |= source[following, word]


@compiled
def extend(winning: Any, reached: Any, spots: Any, times: Any, time: int) -> Any:
    """Add `reached` to `winning` and `time` to `times` (if it has rows); return whether any new."""
    changed = False
    for team in range(winning.shape[0]):
        for word in range(winning.shape[1]):
            added = reached[team, word] & ~winning[team, word]
            if added == np.uint64(0):
                continue
            changed = True
            winning[team, word] |= added
            if times.shape[0]:
                for cell in range(len(spots)):
                    spot = spots[cell]
                    if spot >> 6 == word and (added >> np.uint64(spot & 63)) & np.uint64(1):
                        times[team, cell] = time
    return changed
