"""What scripted agents choose between, of many games at once: compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled
from pursuit.rules.layout import Games, Teams, world_of
from pursuit.rules.step import legal_moves
from scripted_agents.kernels import (
    EVADER,
    RANDOM,
    away_from_nearest,
    list_sought,
    towards_nearest,
)


@compiled
def list_moves(
    kind: int,
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    seat: int,
    counts: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    greedy: Any,
    sought: Any,
    moves: Any,
) -> None:
    """Fill `moves` [games, 2] with the masks that agents draw from: greedy, and every move.

    Arguments are those of `choose_actions`; `sought` is room for all agents or goals, and all mazes
    have tables.
    """
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(moves.shape[0]):
        row, mask = np.uint64(game), np.int64(0)
        maze, own = np.int64(games.maze[row]), np.int64(games.position[row, np.uint64(seat)])
        count = list_sought(kind, games, row, teams, sought)
        if kind == EVADER:
            mask = away_from_nearest(world, maze, own, sought, count, greedy)
        elif kind != RANDOM:
            mask = towards_nearest(world, maze, own, sought, count, greedy)
        every = legal_moves(world, maze, own)
        moves[game, 0], moves[game, 1] = every if mask == 0 else mask, every
