"""Compiled decisions of agents of limited sight: what they remember, and where they go by it.

What is asked of pairs of cells lies as the distance tables do (`pair_index`): `sight` [own, other],
whether the other cell is in view; `towards` and `away`, the moves of an A* agent as bit masks. Of
what is remembered `rows` [games] are the games' rows: `seen_at` [all games, cells] int32, the step
in which a cell was in view last, -1 for never. Everything is int32 unless it says otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled, inlined
from pursuit.rules.distances import NO_PATH, pair_index
from pursuit.rules.layout import (
    Games,
    Teams,
    World,
    chasers_of,
    evaders_of,
    goals_of,
    stream_of,
    world_of,
)
from pursuit.rules.randomness import draw_action
from pursuit.rules.step import legal_moves

FAR = 2**30


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
def draw(
    world: World,
    maze: int,
    own: int,
    mask: int,
    epsilon: float,
    stay_action: bool,
    streams: Any,
    seat: int,
) -> int:
    """One of these moves, or of all where there is none of them, or with probability epsilon."""
    every = legal_moves(world, maze, own)
    return draw_action(every if mask == 0 else mask, every, epsilon, stay_action, streams, seat)


@compiled
def search_evaders(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    streams: Any,
    epsilon_of: Any,
    seat: int,
    counts: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    sight: Any,
    towards: Any,
    rows: Any,
    seen_at: Any,
    aim: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games] of a chaser: to evaders in view, where one was last, or in a sweep.

    `aim` [all games] is the cell where an evader was last in view, -1 where none was, or where it
    has been looked for. `settings` is (epsilon, stay action, whether it remembers evaders).
    """
    default, stay_action, remembers = settings
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(actions.shape[0]):
        row, maze = rows[game], np.int64(games.maze[game])
        own = np.int64(games.position[game, seat])
        look_around(world, maze, own, games.steps[game], sight, seen_at[row])
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
            aim[row] = found
        else:
            if aim[row] == own or not remembers:
                aim[row] = -1
            if aim[row] >= 0:
                mask = np.int64(towards[pair_index(world, maze, own, np.int64(aim[row]))])
            else:
                mask = moves_to_longest_unseen(world, maze, own, towards, seen_at[row])
        epsilon = default if np.isnan(epsilon_of[game, seat]) else epsilon_of[game, seat]
        actions[game] = draw(
            world, maze, own, mask, epsilon, stay_action, streams[game], stream_of(seat)
        )


@compiled
def search_goals(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    streams: Any,
    epsilon_of: Any,
    seat: int,
    counts: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    sight: Any,
    towards: Any,
    rows: Any,
    seen_at: Any,
    known: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games] of a runner: to the nearest goal that it knows of, else a sweep.

    `known` [all games, goals] is the cell of each goal that was in view and not found gone since,
    else -1. `settings` is (epsilon, stay action).
    """
    default, stay_action = settings
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(actions.shape[0]):
        row, maze = rows[game], np.int64(games.maze[game])
        own = np.int64(games.position[game, seat])
        look_around(world, maze, own, games.steps[game], sight, seen_at[row])
        mask, nearest = 0, np.int64(FAR)
        for number in goals_of(teams):
            here = np.int64(games.goal[game, number])
            was = np.int64(known[row, number])
            if here >= 0 and sight[pair_index(world, maze, own, here)]:
                known[row, number] = here
            elif was >= 0 and sight[pair_index(world, maze, own, was)]:
                known[row, number] = -1
            cell = np.int64(known[row, number])
            if cell < 0:
                continue
            pair = pair_index(world, maze, own, cell)
            distance = np.int64(world.tables[pair])
            if distance < nearest:
                mask, nearest = 0, distance
            if distance == nearest:
                mask |= np.int64(towards[pair])
        if nearest == FAR:
            mask = moves_to_longest_unseen(world, maze, own, towards, seen_at[row])
        epsilon = default if np.isnan(epsilon_of[game, seat]) else epsilon_of[game, seat]
        actions[game] = draw(
            world, maze, own, mask, epsilon, stay_action, streams[game], stream_of(seat)
        )


@compiled
def flee_from_seen(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze_of: Any,
    streams: Any,
    epsilon_of: Any,
    seat: int,
    counts: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    sight: Any,
    away: Any,
    rows: Any,
    threat: Any,
    threat_at: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games] of an evader: away from the nearest chaser in view, or last in view.

    `threat` [all games] is the cell of that chaser and `threat_at` the step in which it was seen;
    -1 for none. `settings` is (epsilon, stay action, how many steps it remembers a chaser).
    """
    default, stay_action, remembered = settings
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(actions.shape[0]):
        row, maze = rows[game], np.int64(games.maze[game])
        own, step = np.int64(games.position[game, seat]), games.steps[game]
        nearest = np.int64(FAR)
        for chaser in chasers_of(teams):
            pair = pair_index(world, maze, own, np.int64(games.position[game, chaser]))
            if sight[pair] and np.int64(world.tables[pair]) < nearest:
                nearest = np.int64(world.tables[pair])
                threat[row], threat_at[row] = games.position[game, chaser], step
        if threat[row] >= 0 and threat_at[row] != step:
            empty = sight[pair_index(world, maze, own, np.int64(threat[row]))]
            if empty or step - threat_at[row] > remembered:
                threat[row] = -1
        mask = 0
        if threat[row] >= 0:
            mask = np.int64(away[pair_index(world, maze, own, np.int64(threat[row]))])
        epsilon = default if np.isnan(epsilon_of[game, seat]) else epsilon_of[game, seat]
        actions[game] = draw(
            world, maze, own, mask, epsilon, stay_action, streams[game], stream_of(seat)
        )
