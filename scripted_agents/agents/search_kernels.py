"""Compiled decisions of agents of limited sight: what they remember, and where they go by it.

Tables over pairs of cells have the layout of the distance tables: `sight` [own, other],
whether the other cell is in view; `towards` and `away`, the moves of an A* agent as bit masks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.distances import NO_PATH, pair_index
from pursuit.rules.layout import (
    CHASER,
    EVADER,
    Games,
    Teams,
    World,
    chasers_of,
    evaders_of,
    goals_of,
    world_of,
)

FAR = 2**30


class Remembered(NamedTuple):
    """What is remembered of every game, int32; -1 for nothing.

    Attributes:
        seen_at: [games, cells], the step in which a cell was in view last.
        known: [games, goals], the cell of a goal that was in view and not found gone since.
        aim: [games], the cell where the nearest opponent was in view last, until it is looked for
            in vain.
        aim_at: [games], the step in which it was.
    """

    seen_at: Any
    known: Any
    aim: Any
    aim_at: Any


@inlined
def look_around(world: World, maze: int, own: int, step: int, sight: Any, seen_at: Any) -> None:
    """Remember which cells are in view in this step."""
    first = pair_index(world, maze, own, 0)
    for cell in range(world.num_cells[maze]):
        seen_at[cell] = step if sight[first + cell] else seen_at[cell]


@inlined
def moves_to_longest_unseen(world: World, maze: int, own: int, towards: Any, seen_at: Any) -> int:
    """First steps to the nearest of the cells in reach that were out of view for longest, or 0.

    Cells of one age stay of one age until they are seen, and every step comes closer to one of
    them: so all are seen in the end, and nothing need be remembered of where one was going.
    """
    mask, oldest, nearest, first = 0, FAR, FAR, pair_index(world, maze, own, 0)
    for cell in range(world.num_cells[maze]):
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
    games: Games, game: int, teams: Teams, world: World, own: int, sight: Any, towards: Any,
    kept: Remembered, row: int, remembered: int,
) -> int:  # fmt: skip
    """The moves of a chaser: to evaders in view, where one was last (if that is remembered), or in
    a sweep."""
    maze = np.int64(games.maze[game])
    look_around(world, maze, own, games.steps[game], sight, kept.seen_at[row])
    mask, nearest, found = 0, np.int64(FAR), np.int64(-1)
    for evader in evaders_of(teams):
        cell = np.int64(games.position[game, evader])
        pair = pair_index(world, maze, own, cell)
        if not games.active[game, evader] or not sight[pair]:
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
    games: Games, game: int, teams: Teams, world: World, own: int, sight: Any, towards: Any,
    kept: Remembered, row: int,
) -> int:  # fmt: skip
    """The moves of a runner: to the nearest goal that it knows of, else a sweep."""
    maze = np.int64(games.maze[game])
    look_around(world, maze, own, games.steps[game], sight, kept.seen_at[row])
    mask, nearest = 0, np.int64(FAR)
    for number in goals_of(teams):
        here = np.int64(games.goal[game, number])
        was = np.int64(kept.known[row, number])
        if here >= 0 and sight[pair_index(world, maze, own, here)]:
            kept.known[row, number] = here
        elif was >= 0 and sight[pair_index(world, maze, own, was)]:
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
    games: Games, game: int, teams: Teams, world: World, own: int, sight: Any, away: Any,
    kept: Remembered, row: int, remembered: int,
) -> int:  # fmt: skip
    """The moves of an evader: away from the nearest chaser in view, or last in view."""
    maze, step, nearest = np.int64(games.maze[game]), games.steps[game], np.int64(FAR)
    for chaser in chasers_of(teams):
        pair = pair_index(world, maze, own, np.int64(games.position[game, chaser]))
        if sight[pair] and np.int64(world.tables[pair]) < nearest:
            nearest = np.int64(world.tables[pair])
            kept.aim[row], kept.aim_at[row] = games.position[game, chaser], step
    if kept.aim[row] < 0:
        return 0
    threat = pair_index(world, maze, own, np.int64(kept.aim[row]))
    if kept.aim_at[row] != step and (sight[threat] or step - kept.aim_at[row] > remembered):
        kept.aim[row] = -1
        return 0
    return np.int64(away[threat])


@compiled
def list_moves_by_sight(
    role: int,
    games: Games,
    seat: int,
    counts: Any,
    mazes: Any,
    sight: Any,
    moves: Any,
    rows: Any,
    seen_at: Any,
    known: Any,
    aim: Any,
    aim_at: Any,
    remembered: int,
    masks: Any,
) -> None:
    """Fill `masks` [games] with the moves of an agent of this role, 0 where any will do.

    `moves` are towards or, of an evader, away; `seen_at` to `aim_at` are `Remembered` of all games,
    and `rows` [games] which of them these are. `remembered` is for how many steps an evader keeps
    out of the way of a chaser out of view, and whether a chaser goes where it saw an evader.
    """
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    world = world_of(*mazes)
    kept = Remembered(seen_at, known, aim, aim_at)
    for game in range(masks.shape[0]):
        row, own = rows[game], np.int64(games.position[game, seat])
        if role == CHASER:
            mask = pursue(games, game, teams, world, own, sight, moves, kept, row, remembered)
        elif role == EVADER:
            mask = flee(games, game, teams, world, own, sight, moves, kept, row, remembered)
        else:
            mask = collect(games, game, teams, world, own, sight, moves, kept, row)
        masks[game] = mask
