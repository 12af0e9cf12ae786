"""Slips of moves in exact solutions: a chosen action is a distribution over moves.

The transitions in a `Store` are those of moves. A choice leads to its move, or with the chance of a
slip to a uniformly random one of the moves that change the cell, for each agent on its own. So the
values of choices are those of moves times a small matrix for each deciding player, and the chances
of moves are those of choices times its transpose.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import allocating, subroutine
from scripted_agents.exact.joint.layout import Store


@subroutine
def slip_options(store: Store, state: int, values: Any, transposed: bool) -> None:
    """Multiply `values` [options of all players, any] by the matrix of each player, in place.

    Values of moves become those of choices; `transposed`, chances of choices those of moves.
    """
    after = np.int64(store.shape[state, 0])
    for player in range(store.slips.shape[0]):
        many, keeps = np.int64(store.axes[state, player, 0]), store.axes[state, player, 1]
        after //= many
        moves = many - (keeps >= 0)
        if moves == 0:
            continue
        slip = store.slips[player]
        for block in range(store.shape[state, 0] // (many * after)):
            for inner in range(after):
                first = block * many * after + inner
                for q in range(values.shape[1]):
                    total = 0.0
                    for option in range(many):
                        counts = transposed or option != keeps
                        total += values[first + option * after, q] if counts else 0.0
                    for option in range(many):
                        at = first + option * after
                        values[at, q] *= 1.0 - slip
                        if not transposed or option != keeps:
                            values[at, q] += slip * total / moves


@allocating
def fill_move_chances(store: Store, chances: Any, moved: Any) -> None:
    """Fill `moved` [pairs, 1] with the chances of moves, given those of choices, `chances`."""
    moved[:, 0] = chances
    for state in range(store.shape.shape[0]):
        first = store.pairs[state]
        slip_options(store, state, moved[first : first + store.shape[state, 0]], True)
