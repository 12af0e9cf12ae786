"""The arguments of the kernels of joint games: states, players, quantities and transitions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Numbering(NamedTuple):
    """How states are numbered.

    masks: [groups] int64, bit e for evader number e that is free.
    offsets: [groups + 1] int64, the first state of each group.
    sizes: [groups] int64, the states of one set of goals and exits.
    halves: 2 if a step is half of a round of turns, else 1: each half has its own states.
    group_of: [2**evaders] int64, the group of a mask; -1 if no evader is free.
    sets: [sets, goals] int32, cells in order; -1 behind the last.
    binomials: [cells, at least goals + 1] int64, ways to choose so many of so many cells.
    bases: [goals + 2] int64, the first set of so many goals.
    exits: [any, exits] int32, the sets of exits: the fixed ones, or all sets that can be drawn.
    """

    masks: Any
    offsets: Any
    sizes: Any
    group_of: Any
    sets: Any
    binomials: Any
    bases: Any
    halves: int
    exits: Any


class Players(NamedTuple):
    """The players. A player is one agent, or several agents with a joint distribution.

    seats: [agents] int64, player after player, those that decide first.
    begins: [players + 1] int64, where the seats of each player begin.
    deciding: how many players decide, one seat each.
    moves_first: whether these prefer moves to standing still; else actions in their order.
    codes: [other players, states] uint32, where in `rows` a player's distribution begins.
    rows: float64, distributions over the joint actions of a player's seats, the last one's action
        counting fastest.
    """

    seats: Any
    begins: Any
    deciding: int
    moves_first: bool
    codes: Any
    rows: Any


class Quantities(NamedTuple):
    """What is summed up along a game; Q quantities, of which the first is decided by.

    reward_weights: [Q, agents] float64, the weight of each agent's reward.
    lasting: [Q, agents] int64, 1: a step counts 1 as long as any of these is free.
    ending: [Q] float64, what the end of the game counts.
    """

    reward_weights: Any
    lasting: Any
    ending: Any


class Backup(NamedTuple):
    """What is made of the first quantity: as little as possible, with `sign` -1 as much.

    discount: of what the next step counts. only_whether: 1 for values above 0.
    """

    sign: float
    discount: float
    only_whether: bool


class Store(NamedTuple):
    """What follows each state.

    A state with `shape` (ours, theirs, the first player's) of joint actions has room in `following`
    from `pairs` on and in `sides` and `joints` from `edges` on: the next state of each pair, -1 for
    the end; what ours are worth at once, [ours, Q]; the chances of theirs. The shape of a state
    that cannot be is 0.

    pairs, edges: [states + 1] int64; shape: [states, 4] int32, the last whether a round ends with
    the step, so that what follows is discounted; following: int32; sides: float64; joints: int16.
    slips: [deciding players] float64, the chances of their slips; empty if no moves slip.
    axes: [states, deciding players, 2] int16, the number of options and the index of the one that
    keeps the cell, -1 if there is none; empty if no moves slip.
    """

    pairs: Any
    edges: Any
    shape: Any
    following: Any
    sides: Any
    joints: Any
    slips: Any
    axes: Any


NO_SLIPS = np.zeros(0), np.zeros((0, 0, 2), dtype=np.int16)
"""The last two fields of a `Store` where no moves slip."""


def places_within(sizes: NDArray[np.integer]) -> NDArray[np.int64]:
    """[sum of sizes] int64: 0, 1, ... for the entries of each of several groups of these sizes."""
    begins = np.cumsum(sizes) - sizes
    return np.asarray(np.arange(sizes.sum()) - np.repeat(begins, sizes), dtype=np.int64)


class Workspace(NamedTuple):
    """Scratch memory of one state: its contents, and the actions of every player.

    cells, active: [agents] int64; goals: [goals] int64; actions: [1, agents] int32.
    option: [players, joint actions] int64, those that lead to different cells; `many` [players] of
    them, of which the one with the index `keeps` [players] keeps the cell (-1 if none does), with
    their `chance` [players, joint actions], and `pick` [players] int64, one of them.
    worth: [joint actions of those that decide, Q] float64. best: [Q] float64.
    """

    cells: Any
    active: Any
    goals: Any
    actions: Any
    option: Any
    many: Any
    pick: Any
    keeps: Any
    chance: Any
    worth: Any
    best: Any
