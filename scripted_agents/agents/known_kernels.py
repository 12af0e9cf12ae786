"""Decisions of small teams, compiled for fixed numbers of agents and targets.

The compiler unrolls loops of constant length, which takes a third to half off the time of 2v2 and
4v4 teams. The actions are the same as those of `kernels`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.batches import MOST_KNOWN
from pursuit.rules.layout import CHASER, EVADER, Games, World, stay_of
from pursuit.rules.lookups import away_from_nearest, towards_nearest, write_action
from pursuit.rules.turn import legal_moves
from scripted_agents.agents.kernels import add_target

__all__ = ["MOST_KNOWN", "in_rows", "team_entry_for"]

MOST_PADDED = 2
"""Chasers of more evaders than these loop only over the remaining ones."""


@inlined
def in_rows(position: Any, active: Any, epsilon_of: Any) -> bool:
    """Whether the entries of the agents of a game are contiguous in memory."""
    if position.strides[1] != 4 or active.strides[1] != 4 or epsilon_of.strides[1] != 8:  # noqa: SIM103
        return False
    return True


@cache
def team_entry_for(kind: int, num_seats: int, num_targets: int) -> Any:
    """The kernel of `num_seats` agents with consecutive indices and a constant number of targets.

    `kind` is CHASER, EVADER or RUNNER. Arguments and results are those of `kernels.entry_for`. All
    mazes must have tables and at most four moves, `columns` must be consecutive, and arrays must be
    `in_rows`.
    """
    padded = kind == EVADER or (kind == CHASER and num_targets <= MOST_PADDED)

    @compiled
    def choose_actions(
        position: Any, active: Any, event: Any, goal: Any, steps: Any, maze_of: Any, exit_of: Any,
        streams: Any, epsilon_of: Any, seats: Any, columns: Any, counts: Any, mazes: Any,
        neighbors: Any, facts: Any, tables: Any, greedy: Any, scratch: Any, settings: Any,
        actions: Any,
    ) -> None:  # fmt: skip
        """Fill the columns of these agents in `actions` [games, any]."""
        if not in_rows(position, active, epsilon_of):
            return  # never happens; the check gives the compiler the memory layout
        default, _, _, stay_action = settings
        games = Games(position, active, event, goal, steps, maze_of, exit_of)
        world = World(mazes, neighbors, facts, tables)
        empty: Any = stay_of(world.neighbors) * np.int64(stay_action)
        targets = scratch[scratch.shape[0] - 1]  # the last row is not used by searches
        first, column = np.uint64(seats[0]), np.uint64(columns[0])
        first_target = np.uint64(counts[0] if kind == CHASER else 0)
        for game in range(actions.shape[0]):
            row, count = np.uint64(game), 0
            maze: Any = np.int64(games.maze[row])
            for i in range(num_targets):
                target = first_target + np.uint64(i)
                count = add_target(kind, games, row, target, targets, count)
            num_listed = count
            if padded:  # repeat the first target for a constant length, which changes no decision
                num_listed = num_targets
                for i in range(1, num_targets):
                    targets[i] = targets[np.uint64(i if i < count else 0)]
            for i in range(num_seats):
                seat = first + np.uint64(i)
                own: Any = np.int64(games.position[row, seat])
                mask: Any
                if kind == EVADER:
                    mask = away_from_nearest(world, maze, own, targets, num_listed, greedy)
                else:
                    mask = towards_nearest(world, maze, own, targets, num_listed, greedy)
                mask = mask if count > 0 else np.int64(0)
                every = legal_moves(world, maze, own)
                share = epsilon_of[row, seat]
                into = column + np.uint64(i)
                write_action(
                    actions, row, into, mask, every, share, default, empty, True, streams, seat
                )

    return choose_actions
