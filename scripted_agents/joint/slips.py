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
from scripted_agents.joint.layout import Store


@subroutine
def slip_values(store: Store, state: int, values: Any) -> None:
    """Make the values of moves those of choices, `values` [options of all players, any]."""
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
                        total += values[first + option * after, q] if option != keeps else 0.0
                    for option in range(many):
                        own = values[first + option * after, q]
                        values[first + option * after, q] = (
                            1.0 - slip
                        ) * own + slip * total / moves


@subroutine
def slip_chances(store: Store, state: int, chances: Any) -> None:
    """Make the chances of choices those of moves, `chances` [options of all players]."""
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
                first, total = block * many * after + inner, 0.0
                for option in range(many):
                    total += chances[first + option * after]
                for option in range(many):
                    at = first + option * after
                    chances[at] *= 1.0 - slip
                    chances[at] += slip * total / moves if option != keeps else 0.0


@allocating
def fill_move_chances(store: Store, chances: Any, moved: Any) -> None:
    """Fill `moved` [pairs] with the chances of moves, given those of choices."""
    moved[:] = chances
    for state in range(store.shape.shape[0]):
        first = store.pairs[state]
        slip_chances(store, state, moved[first : first + store.shape[state, 0]])
