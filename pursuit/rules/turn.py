"""One game of a batch in a step, and what all decisions ask of it."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Ints, Reals
from pursuit.rules.distances import place_of
from pursuit.rules.layout import (
    ACTIVE,
    ADJACENT,
    AFTER,
    CAPTORS,
    FIRST_CELL,
    GOAL,
    MAZE,
    MOVES,
    POSITION,
    SURROUND,
    Memory,
    StepRules,
    World,
    stay_of,
)


@inlined
def legal_moves(world: World, maze: int, cell: int) -> int:
    """The bit mask of the moves that change the cell."""
    return np.int64(world.facts[MOVES, place_of(world.mazes[FIRST_CELL, maze], cell)])


class Turn(NamedTuple):
    """One game of a batch in a step.

    agents, clocks, reals: the rows of the game in those of `Memory`. neighbors, facts: those of
    `World`, in which the cells of the game's maze begin at `first_cell`. plan: the scratch
    memory of the step, see `layout.scratch_for`.
    """

    agents: Ints
    clocks: Ints
    reals: Reals
    rules: StepRules
    neighbors: Ints
    facts: Ints
    first_cell: int
    plan: Ints


Goals: TypeAlias = Ints | None
"""[goals] the cells of the goals of a game; None where the compiler is to leave out the rules of
goals, which take long to compile."""


@inlined
def goals_of_game(memory: Memory, game: int, goals: Goals) -> Goals:
    """The cells of the goals of a game; None if the goals of the batch are None."""
    if goals is None:
        return None
    return memory.goals[game, GOAL]


@inlined
def turn_of(memory: Memory, game: int, rules: StepRules, world: World, plan: Ints) -> Turn:
    """The step of one game of a batch."""
    return Turn(
        memory.agents[game], memory.clocks[game], memory.reals[game],
        rules, world.neighbors, world.facts,
        world.mazes[FIRST_CELL, memory.clocks[game, MAZE]], plan,
    )  # fmt: skip


@inlined
def destination(turn: Turn, agent: int, action: int) -> int:
    """The cell that an agent's action leads to."""
    cell = place_of(turn.first_cell, turn.agents[POSITION, agent])
    return turn.neighbors[cell, np.uint64(action)]


@inlined
def meets_evader(turn: Turn, chaser: int, evader: int) -> bool:
    """Whether a chaser meets the condition of the capture rule by the cells after the moves.

    With "surround" that is to stand where a move of the evader leads to; whether this is so of all
    such cells is decided in `option_step`.
    """
    capture, cells, after = turn.rules.options.capture, turn.agents[POSITION], turn.plan[AFTER]
    here, there = after[chaser], after[evader]
    if capture == SURROUND:
        return leads_to(turn.neighbors, turn.first_cell, there, here)
    if capture == ADJACENT and leads_to(turn.neighbors, turn.first_cell, here, there):
        return True
    swapped = (here == cells[evader]) & (there == cells[chaser])
    return (here == there) | (swapped & (not turn.rules.chasers_first))


@inlined
def leads_to(neighbors: Ints, first_cell: int, cell: int, other: int) -> bool:
    """Whether a move leads from a cell to another one."""
    place, found = place_of(first_cell, cell), False
    for action in range(stay_of(neighbors)):
        found |= neighbors[place, action] == other
    return found & (cell != other)


@inlined
def may_collect(turn: Turn, agent: int) -> bool:
    """Whether an agent is a runner, or an evader that is free and stays in the game now."""
    if agent >= turn.rules.teams.chasers + turn.rules.teams.evaders:
        return True
    return (turn.agents[ACTIVE, agent] != 0) & (turn.plan[CAPTORS, agent] == 0)


@inlined
def is_free(agents: Ints, evader: int) -> int:
    """1 if an evader was free before the step, 0 if it had been captured."""
    return np.int64(agents[ACTIVE, evader] != 0)
