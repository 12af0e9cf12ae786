"""Compiled decisions of agents with a limited view: updates of their memory, and their moves.

Tables over pairs of cells have the layout of the distance tables: `visible` [own, other] is whether
the other cell is in view; `towards` and `away` are the moves of an A* agent as bit masks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.distances import NO_PATH, pair_index, table_distance
from pursuit.rules.layout import (
    CHASER,
    EVADER,
    NUM_CELLS,
    Games,
    Teams,
    World,
    chasers_of,
    evaders_of,
    goals_of,
)

FAR = 2**30


class SearchMemory(NamedTuple):
    """The memory of every game, int32; -1 for nothing.

    Attributes:
        seen_at: [games, cells], the last step in which a cell was in view.
        known: [games, goals], the cell of a goal that was seen and not yet found to be collected.
        aim: [games], the last visible cell of the nearest opponent; -1 once it is known to be left.
        aim_at: [games], the step in which the opponent was seen there.
    """

    seen_at: Any
    known: Any
    aim: Any
    aim_at: Any


@inlined
def mark_visible(world: World, maze: int, own: int, step: int, visible: Any, seen_at: Any) -> None:
    """Store the step for all cells in view."""
    first = pair_index(world, maze, own, 0)
    for cell in range(world.mazes[NUM_CELLS, maze]):
        seen_at[cell] = step if visible[first + cell] else seen_at[cell]


@inlined
def moves_to_longest_unseen(world: World, maze: int, own: int, towards: Any, seen_at: Any) -> int:
    """First steps to the nearest of the reachable cells that were out of view for longest, or 0.

    Cells of equal age keep equal ages until they are seen, and every step approaches one of them.
    So all cells are seen eventually, without a stored destination.
    """
    mask, oldest, nearest, first = 0, FAR, FAR, pair_index(world, maze, own, 0)
    for cell in range(world.mazes[NUM_CELLS, maze]):
        if seen_at[cell] > oldest:
            continue
        distance = np.int64(world.tables[first + cell])
        if distance == NO_PATH:
            continue
        if seen_at[cell] < oldest or distance < nearest:
            mask, oldest, nearest = 0, np.int64(seen_at[cell]), distance
        if distance == nearest:
            mask |= np.int64(towards[first + cell])
    return mask


@inlined
def pursue(
    games: Games, game: int, teams: Teams, world: World, own: int, visible: Any, towards: Any,
    kept: SearchMemory, row: int, remembered: int,
) -> int:  # fmt: skip
    """The moves of a chaser: to evaders in view, to where one was last seen (with `remembered`), or
    in a sweep."""
    maze = np.int64(games.maze[game])
    mark_visible(world, maze, own, games.steps[game], visible, kept.seen_at[row])
    mask, nearest, found = 0, np.int64(FAR), np.int64(-1)
    for evader in evaders_of(teams):
        cell = np.int64(games.position[game, evader])
        pair = pair_index(world, maze, own, cell)
        if not games.active[game, evader] or not visible[pair]:
            continue
        distance = np.int64(world.tables[pair])
        if distance < nearest:
            mask, nearest, found = 0, distance, cell
        if distance == nearest:
            mask |= np.int64(towards[pair])
    if found >= 0:
        kept.aim[row] = found
        return mask
    if kept.aim[row] == own or not remembered:
        kept.aim[row] = -1
    if kept.aim[row] >= 0:
        return np.int64(towards[pair_index(world, maze, own, np.int64(kept.aim[row]))])
    return moves_to_longest_unseen(world, maze, own, towards, kept.seen_at[row])


@inlined
def collect(
    games: Games, game: int, teams: Teams, world: World, own: int, visible: Any, towards: Any,
    kept: SearchMemory, row: int,
) -> int:  # fmt: skip
    """The moves of a runner: to the nearest known goal, else in a sweep."""
    maze = np.int64(games.maze[game])
    mark_visible(world, maze, own, games.steps[game], visible, kept.seen_at[row])
    mask, nearest = 0, np.int64(FAR)
    for number in goals_of(teams):
        here = np.int64(games.goal[game, number])
        was = np.int64(kept.known[row, number])
        if here >= 0 and visible[pair_index(world, maze, own, here)]:
            kept.known[row, number] = here
        elif was >= 0 and visible[pair_index(world, maze, own, was)]:
            kept.known[row, number] = -1
        cell = np.int64(kept.known[row, number])
        if cell < 0:
            continue
        pair = pair_index(world, maze, own, cell)
        distance = np.int64(world.tables[pair])
        if distance < nearest:
            mask, nearest = 0, distance
        if distance == nearest:
            mask |= np.int64(towards[pair])
    if nearest == FAR:
        return moves_to_longest_unseen(world, maze, own, towards, kept.seen_at[row])
    return mask


@inlined
def flee(
    games: Games, game: int, teams: Teams, world: World, own: int, visible: Any, away: Any,
    kept: SearchMemory, row: int, remembered: int,
) -> int:  # fmt: skip
    """The moves of an evader: away from the nearest chaser in view, or from where one was seen."""
    maze, step, nearest = np.int64(games.maze[game]), games.steps[game], np.int64(FAR)
    for chaser in chasers_of(teams):
        cell = np.int64(games.position[game, chaser])
        distance = table_distance(world, maze, cell, own)
        if visible[pair_index(world, maze, own, cell)] and distance < nearest:
            nearest = distance
            kept.aim[row], kept.aim_at[row] = games.position[game, chaser], step
    if kept.aim[row] < 0:
        return 0
    threat = pair_index(world, maze, own, np.int64(kept.aim[row]))
    if kept.aim_at[row] != step and (visible[threat] or step - kept.aim_at[row] > remembered):
        kept.aim[row] = -1
        return 0
    return np.int64(away[threat])


@compiled
def list_moves_in_view(
    role: int, games: Games, seat: int, counts: Any, world: World, visible: Any, moves: Any,
    rows: Any, kept: SearchMemory, remembered: int, masks: Any,
) -> None:  # fmt: skip
    """Fill `masks` [games] with the moves of an agent of this role; 0 for any move.

    `moves` are `towards`, or `away` for an evader. `kept` is the memory of all games, and `rows`
    [games] the rows of these games in it. `remembered` is the number of steps for which an evader
    avoids a chaser that is out of view; for a chaser, 1 to go to where an evader was last seen,
    else 0.
    """
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    for game in range(masks.shape[0]):
        row, own = rows[game], np.int64(games.position[game, seat])
        if role == CHASER:
            mask = pursue(games, game, teams, world, own, visible, moves, kept, row, remembered)
        elif role == EVADER:
            mask = flee(games, game, teams, world, own, visible, moves, kept, row, remembered)
        else:
            mask = collect(games, game, teams, world, own, visible, moves, kept, row)
        masks[game] = mask
