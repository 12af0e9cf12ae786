"""One game of a batch in a step, and what all decisions ask of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.distances import place_of
from pursuit.rules.layout import (
    ADJACENT,
    SURROUND,
    Games,
    Outcome,
    StepRules,
    StepScratch,
    World,
    stay_of,
)


@inlined
def legal_moves(world: World, maze: int, cell: int) -> int:
    """The bit mask of the moves that change the cell."""
    return np.int64(world.moves[place_of(world.first_cell[maze], cell)])


class Turn(NamedTuple):
    """One game of a batch in a step.

    first_cell: the index in the arrays of `world` of the first cell of the game's maze. plan: the
    decisions of the step.
    """

    games: Games
    game: int
    rules: StepRules
    world: World
    first_cell: int
    plan: StepScratch
    outcome: Outcome


@inlined
def destination(turn: Turn, agent: int, action: int) -> int:
    """The cell that an agent's action leads to."""
    cell = place_of(turn.first_cell, turn.games.position[turn.game, agent])
    return turn.world.neighbors[cell, np.uint64(action)]


@inlined
def meets_evader(turn: Turn, chaser: int, evader: int) -> bool:
    """Whether a chaser meets the condition of the capture rule by the cells after the moves.

    With "surround" that is to stand where a move of the evader leads to; whether this is so of all
    such cells is decided in `option_step`.
    """
    capture, after = turn.rules.options.capture, turn.plan.after
    if capture == SURROUND:
        return leads_to(turn, after[evader], after[chaser])
    if capture == ADJACENT and leads_to(turn, after[chaser], after[evader]):
        return True
    cells = turn.games.position[turn.game]
    swapped = (after[chaser] == cells[evader]) & (after[evader] == cells[chaser])
    return (after[chaser] == after[evader]) | (swapped & (not turn.rules.chasers_first))


@inlined
def leads_to(turn: Turn, cell: int, other: int) -> bool:
    """Whether a move leads from a cell to another one."""
    place, found = place_of(turn.first_cell, cell), False
    for action in range(stay_of(turn.world)):
        found |= turn.world.neighbors[place, action] == other
    return found & (cell != other)


@inlined
def may_collect(turn: Turn, agent: int) -> bool:
    """Whether an agent is a runner, or an evader that is free and stays in the game now."""
    if agent >= turn.rules.teams.chasers + turn.rules.teams.evaders:
        return True
    return (turn.games.active[turn.game, agent] != 0) & (turn.plan.captors[agent] == 0)


@inlined
def is_free(turn: Turn, evader: int) -> int:
    """1 if an evader was free before the step, 0 if it had been captured."""
    return np.int64(turn.games.active[turn.game, evader] != 0)
