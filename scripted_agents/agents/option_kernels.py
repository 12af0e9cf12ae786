"""Compiled greedy moves of the scripted agents under options of the rules: cells around an evader,
and exits. They need mazes with tables of distances.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.distances import FAR, moves_of, table_distance
from pursuit.rules.layout import FIRST_CELL, Games, Teams, World, chasers_of, evaders_of, stay_of
from scripted_agents.agents.kernels import first_steps


@inlined
def waiting(world: World, maze: Any, own: Any, stay_action: bool) -> Any:
    """The bit mask of the actions that keep the cell: stay or, without it, moves into a wall."""
    if stay_action:
        return 1 << stay_of(world.neighbors)
    mask = 0
    for action in moves_of(world.neighbors):
        mask |= (world.neighbors[world.mazes[FIRST_CELL, maze] + own, action] == own) << action
    return mask


@inlined
def evader_to_surround(world: World, games: Games, game: int, teams: Teams) -> Any:
    """The free evader with the least sum of distances from the chasers; -1 if there is none."""
    best, least = -1, FAR
    maze: Any = np.int64(games.maze[game])
    for evader in evaders_of(teams):
        if games.active[game, evader] == 0:
            continue
        total = 0
        for chaser in chasers_of(teams):
            cell = games.position[game, chaser]
            away = table_distance(world, maze, cell, games.position[game, evader])
            total += min(away, 1 << 20)
        if total < least:
            best, least = evader, total
    return best


@inlined
def place_around(
    world: World, games: Games, game: int, teams: Teams, evader: Any, seat: int, targets: Any
) -> Any:
    """The cell next to an evader that is assigned to the chaser `seat`; its own cell if there are
    more chasers than cells.

    Of all pairs of a chaser and a free cell the nearest is assigned first, of equally near ones
    that of the first chaser and the first cell. `targets` [chasers] is scratch memory.
    """
    maze: Any = np.int64(games.maze[game])
    here: Any = np.int64(games.position[game, evader])
    first = world.mazes[FIRST_CELL, maze]
    for chaser in chasers_of(teams):
        targets[chaser] = -1
    for _ in chasers_of(teams):
        least, best_chaser = FAR, -1
        best_cell: Any = -1
        for chaser in chasers_of(teams):
            if targets[chaser] >= 0:
                continue
            for action in moves_of(world.neighbors):
                cell: Any = np.int64(world.neighbors[first + here, action])
                free = cell != here
                for other in chasers_of(teams):
                    free &= targets[other] != cell
                away = table_distance(world, maze, games.position[game, chaser], cell)
                if free and away < least:
                    least, best_chaser, best_cell = away, chaser, cell
        if best_chaser < 0:
            break
        targets[best_chaser] = best_cell
        if best_chaser == seat:
            break
    return np.int64(targets[seat]) if targets[seat] >= 0 else here


@compiled
def list_surrounding_moves(
    games: Games, seat: int, counts: Any, world: World, stay_action: bool, targets: Any, moves: Any
) -> None:
    """Fill `moves` [games] with the greedy moves of a chaser to its cell next to an evader."""
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    for game in range(moves.shape[0]):
        maze: Any = np.int64(games.maze[game])
        own: Any = np.int64(games.position[game, seat])
        evader = evader_to_surround(world, games, game, teams)
        moves[game] = 0
        if evader >= 0:
            target = place_around(world, games, game, teams, evader, seat, targets)
            if own == target:
                moves[game] = waiting(world, maze, own, stay_action)
            else:
                moves[game] = first_steps(world, maze, own, target)


@compiled
def list_escaping_moves(games: Games, seat: int, counts: Any, world: World, moves: Any) -> None:
    """Write the first steps to the nearest exits that an evader reaches before any chaser into
    `moves` [games]; games without such an exit are left as they are."""
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    for game in range(moves.shape[0]):
        maze: Any = np.int64(games.maze[game])
        own: Any = np.int64(games.position[game, seat])
        least, mask = FAR, 0
        for number in range(games.exit.shape[1]):
            cell: Any = np.int64(games.exit[game, number])
            if cell < 0:
                continue
            away = table_distance(world, maze, own, cell)
            reached = away < FAR
            for chaser in chasers_of(teams):
                reached &= away < table_distance(world, maze, games.position[game, chaser], cell)
            if not reached or away > least:
                continue
            mask = first_steps(world, maze, own, cell) | (mask if away == least else 0)
            least = away
        if least < FAR:
            moves[game] = mask
