"""The decisions of small teams, compiled for exactly so many agents and opponents.

Numbers that the compiler knows let it undo the loops: agents of 2v2 and 4v4 decide in half to two
thirds of the time. Which kernel fills a seat changes nothing of what is decided.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.batches import MOST_KNOWN
from pursuit.rules.layout import CHASER, EVADER, RUNNER, Games, world_of
from pursuit.rules.lookups import away_from_nearest, take, towards_nearest
from pursuit.rules.step import legal_moves

__all__ = ["MOST_KNOWN", "in_rows", "team_entry_for"]

MOST_PADDED = 2
"""With more evaders than these, chasers check only those that are left."""


@inlined
def in_rows(position: Any, active: Any, epsilon_of: Any) -> bool:
    """Whether what belongs to the agents of a game lies side by side."""
    if position.strides[1] != 4 or active.strides[1] != 4 or epsilon_of.strides[1] != 8:  # noqa: SIM103
        return False
    return True


@cache
def team_entry_for(kind: int, num_seats: int, num_sought: int) -> Any:
    """The decisions of `count` agents with consecutive indices, for a constant number of targets.

    `kind` is CHASER, EVADER or RUNNER. As `kernels.entry_for`'s decide, with the same arguments, in
    mazes that all have tables, into neighbouring `columns`, with arrays that are `in_rows`.
    """
    padded = kind == EVADER or (kind == CHASER and num_sought <= MOST_PADDED)

    @compiled
    def choose_actions(
        position: Any,
        active: Any,
        event: Any,
        goal: Any,
        steps: Any,
        maze_of: Any,
        streams: Any,
        epsilon_of: Any,
        seats: Any,
        columns: Any,
        counts: Any,
        mazes: Any,
        neighbors: Any,
        facts: Any,
        tables: Any,
        greedy: Any,
        scratch: Any,
        settings: Any,
        actions: Any,
    ) -> None:
        """Fill the columns of these seats in `actions` [games, any]."""
        if not in_rows(position, active, epsilon_of):
            return  # checked before; here it gives the compiler the layout
        default, _, _, stay_action = settings
        games = Games(position, active, event, goal, steps, maze_of)
        world = world_of(mazes, neighbors, facts, tables)
        sought = scratch[scratch.shape[0] - 1]  # the row that is no search's
        first, column = np.uint64(seats[0]), np.uint64(columns[0])
        first_sought = np.uint64(counts[0] if kind == CHASER else 0)
        for game in range(actions.shape[0]):
            row, count = np.uint64(game), 0
            maze: Any = np.int64(games.maze[row])
            for i in range(num_sought):
                number = first_sought + np.uint64(i)
                if kind == RUNNER:
                    sought[np.uint64(count)] = games.goal[row, number]
                    count += games.goal[row, number] >= 0
                else:
                    sought[np.uint64(count)] = games.position[row, number]
                    count += games.active[row, number] != 0
            looked_at = count
            if padded:  # with one of them again, which changes nothing, so that all games are alike
                looked_at = num_sought
                for i in range(1, num_sought):
                    sought[i] = sought[np.uint64(i if i < count else 0)]
            for i in range(num_seats):
                seat = first + np.uint64(i)
                own: Any = np.int64(games.position[row, seat])
                mask: Any
                if kind == EVADER:
                    mask = away_from_nearest(world, maze, own, sought, looked_at, greedy)
                else:
                    mask = towards_nearest(world, maze, own, sought, looked_at, greedy)
                mask = mask if count > 0 else np.int64(0)
                every = legal_moves(world, maze, own)
                share = epsilon_of[row, seat]
                into = column + np.uint64(i)
                take(actions, row, into, mask, every, share, default, stay_action, streams, seat)

    return choose_actions
