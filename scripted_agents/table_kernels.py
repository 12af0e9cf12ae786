"""Compiled play of policy tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled
from pursuit.rules.layout import Games, stream_of, world_of
from pursuit.rules.randomness import draw_action, next_uniform
from pursuit.rules.step import legal_moves


@compiled
def sample_table(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    streams: Any,
    epsilon_of: Any,
    seat: int,
    opponents: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    cumulative: Any,
    table_offsets: Any,
    default: float,
    actions: Any,
) -> None:
    """Fill `actions` [games] from a policy table, given as cumulative sums over the actions.

    The other cell is that of the first active opponent. `cumulative` is [all pairs, actions], the
    pairs of maze m beginning at `table_offsets[m]`.
    """
    games = Games(position, active, event, goal, steps, maze_of)
    world, stream = world_of(mazes, neighbors, facts, tables), stream_of(seat)
    num_actions = cumulative.shape[1]
    for game in range(actions.shape[0]):
        actions[game] = 0
        maze, own = np.int64(games.maze[game]), np.int64(games.position[game, seat])
        other = np.int64(-1)
        for i in range(opponents.shape[0]):
            if other < 0 and games.active[game, opponents[i]]:
                other = np.int64(games.position[game, opponents[i]])
        if other < 0 or not games.active[game, seat]:
            continue
        epsilon = epsilon_of[game, seat]
        if np.isnan(epsilon):
            epsilon = default
        if epsilon > 0.0 and next_uniform(streams[game], stream) < epsilon:
            every = legal_moves(world, maze, own)
            actions[game] = draw_action(every, every, 0.0, num_actions == 5, streams[game], stream)
            continue
        pair = table_offsets[maze] + own * world.num_cells[maze] + other
        draw = next_uniform(streams[game], stream) * cumulative[pair, num_actions - 1]
        while actions[game] < num_actions - 1 and draw >= cumulative[pair, actions[game]]:
            actions[game] += 1
