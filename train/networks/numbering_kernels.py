"""Compiled kernels that number the states of games in mazes."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules import Games


@inlined
def number_state(games: Games, game: int, cells: int, binomials: Any) -> Any:
    """The state number of one game; see `number_states`."""
    agents, goals = games.position.shape[1], games.goal.shape[1]
    base = cells + 1 if agents > 2 else cells
    state = np.int64(0)
    for agent in range(agents):
        alive = games.active[game, agent] != 0
        state = state * base + (games.position[game, agent] if alive else base - 1)
    if goals == 0:
        return state
    number = np.int64(0)
    left = 0
    for goal in range(goals):
        cell = games.goal[game, goal]
        if cell >= 0:
            # The rank of a goal is counted instead of sorting: no branch depends on the order.
            rank = 1
            for other in range(goals):
                beside = games.goal[game, other]
                rank += (beside >= 0) & (beside < cell)
            number += binomials[cell, rank]
            number += binomials[cells, left]  # sets with fewer goals come first
            left += 1
    return state * binomials[cells + 1, 0] + number


@compiled
def number_states(
    position: Any, active: Any, event: Any, goal: Any, steps: Any, maze: Any, exit_of: Any,
    cells: int, binomials: Any, chosen: Any, states: Any,
) -> None:  # fmt: skip
    """The state number of every game that is `chosen`.

    Agents are digits of base `cells` (+ 1 for a captured one, where there are several evaders). The
    remaining goals are an unordered set, numbered in the combinatorial number system.

    Args:
        position, active, event, goal, steps, maze, exit_of: the arrays of `pursuit.rules.Games`.
        cells: of the task's maze.
        binomials: [cells + 2, goals + 1] int64, n over k; in the last row the number of sets.
        chosen: [games] bool; the states of others are not written.
        states: [games] int64, out.
    """
    games = Games(position, active, event, goal, steps, maze, exit_of)
    for game in range(states.shape[0]):
        if chosen[game]:
            states[game] = number_state(games, game, cells, binomials)
