"""The decisions of the scripted agents, compiled: which moves are greedy, and which one is taken.

A set of moves is a bit mask over the actions. The same functions fill the tables of exact
probabilities and act in the batch, so that what is solved exactly is what plays.

Entries are given `*view.games` and `*view.mazes`; `scratch` is int32 [NUM_SCRATCH, cells of the
largest maze], -1 in the rows of distances: room for two searches, one within the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled, inlined, subroutine
from pursuit.rules.distances import (
    distance_within,
    forget,
    has_table,
    pair_index,
    search_within,
    table_distance,
)
from pursuit.rules.layout import (
    STAY,
    Games,
    Search,
    Teams,
    World,
    chasers_of,
    evaders_of,
    goals_of,
    stream_of,
    world_of,
)
from pursuit.rules.randomness import draw_action, next_uniform
from pursuit.rules.step import legal_moves

CHASER, EVADER, RUNNER, RANDOM = range(4)
FAR = 2**30
LOOK_DISTANCE, LOOK_QUEUE, PATH_DISTANCE, PATH_QUEUE, NUM_SCRATCH = range(5)


@inlined
def look_of(scratch: Any) -> Search:
    """Room for the search around oneself."""
    return Search(scratch[LOOK_DISTANCE], scratch[LOOK_QUEUE])


@inlined
def path_of(scratch: Any) -> Search:
    """Room for searches for a path."""
    return Search(scratch[PATH_DISTANCE], scratch[PATH_QUEUE])


@subroutine
def mask_towards(
    world: World, search: Search, maze: int, own: int, targets: Any, count: int
) -> int:
    """First steps of shortest paths to the nearest of `targets[:count]`; 0 if there is none.

    One breadth-first search from all targets at once, until it comes to one's own cell.
    """
    first_cell = world.first_cell[maze]
    head = tail = 0
    for i in range(count):
        if search.distance[targets[i]] < 0:
            search.distance[targets[i]] = 0
            search.queue[tail] = targets[i]
            tail += 1
    while head < tail:
        cell = search.queue[head]
        head += 1
        if cell == own:
            break
        for action in range(4):
            after = world.neighbors[first_cell + cell, action]
            if search.distance[after] < 0:
                search.distance[after] = search.distance[cell] + 1
                search.queue[tail] = after
                tail += 1
    mask, nearest = 0, search.distance[own]
    if nearest > 0:
        for action in range(4):
            if search.distance[world.neighbors[first_cell + own, action]] == nearest - 1:
                mask |= 1 << action
    forget(search, tail)
    return mask


@subroutine
def mask_fleeing(
    world: World,
    scratch: Any,
    maze: int,
    own: int,
    threat: int,
    reach: int,
    look_radius: int,
    stay_action: bool,
) -> int:
    """First steps of shortest paths to the cells within `look_radius` farthest from `threat`.

    Where one's own cell is as far as any, staying if that is an action, else every move.
    `reach` is at least the distance between `threat` and any cell looked at.
    """
    look, path = look_of(scratch), path_of(scratch)
    seen = search_within(world, maze, own, look_radius, -1, look)
    farthest = own_distance = distance_within(world, path, maze, own, threat, reach)
    for i in range(seen):
        away = distance_within(world, path, maze, look.queue[i], threat, reach)
        farthest = max(farthest, away)
    mask = 0
    if farthest == own_distance:
        mask = 1 << STAY if stay_action else legal_moves(world, maze, own)
    else:
        for i in range(seen):
            cell = look.queue[i]
            if farthest != distance_within(world, path, maze, cell, threat, reach):
                continue
            steps = np.int64(look.distance[cell])
            for action in range(4):
                after = world.neighbors[world.first_cell[maze] + own, action]
                if after != own and not mask >> action & 1:
                    rest = distance_within(world, path, maze, after, cell, steps)
                    if rest == steps - 1:
                        mask |= 1 << action
    forget(look, seen)
    return mask


@compiled
def fill_greedy_table(
    kind: int,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    scratch: Any,
    settings: Any,
    greedy: Any,
) -> None:
    """Fill `greedy`, laid out as `tables`: the mask at [own, other]; 0 where any move will do.

    `settings` is (epsilon, alert distance, look radius, stay action).
    """
    world = world_of(mazes, neighbors, facts, tables)
    _, alert, look, stay_action = settings
    for maze in range(world.num_cells.shape[0]):
        if not has_table(world, maze):
            continue
        for own in range(world.num_cells[maze]):
            for other in range(world.num_cells[maze]):
                mask, distance = 0, table_distance(world, maze, own, other)
                if kind == EVADER and 0 < distance < alert:
                    mask = mask_fleeing(
                        world, scratch, maze, own, other, alert + look, look, stay_action
                    )
                elif kind != EVADER:
                    for action in range(4):
                        after = world.neighbors[world.first_cell[maze] + own, action]
                        if table_distance(world, maze, after, other) == distance - 1:
                            mask |= 1 << action
                greedy[pair_index(world, maze, own, other)] = mask


@inlined
def sought_by(kind: int, teams: Teams) -> Any:
    """The numbers of whom an agent of this kind heads for, or keeps away from."""
    if kind == CHASER:
        return evaders_of(teams)
    if kind == EVADER:
        return chasers_of(teams)
    if kind == RUNNER:
        return goals_of(teams)
    return range(0, 0)


@inlined
def cell_of_sought(kind: int, games: Games, game: int, number: int) -> int:
    """The cell of a goal or of an opponent; -1 where it is gone."""
    if kind == RUNNER:
        return np.int64(games.goal[game, number])
    return np.int64(games.position[game, number]) if games.active[game, number] else -1


@inlined
def nearest_by_table(
    kind: int,
    games: Games,
    game: int,
    own: int,
    limit: int,
    teams: Teams,
    world: World,
    greedy: Any,
) -> int:
    """The greedy moves towards all that are nearest, or away from the first that is nearest.

    `limit` is a distance that does not count any more.
    """
    maze = np.int64(games.maze[game])
    mask, nearest = 0, limit
    for number in sought_by(kind, teams):
        cell = cell_of_sought(kind, games, game, number)
        if cell >= 0:
            pair = pair_index(world, maze, own, cell)
            distance, moves = np.int64(world.tables[pair]), np.int64(greedy[pair])
            if distance < nearest:
                nearest, mask = distance, moves
            elif distance == nearest and kind != EVADER:
                mask |= moves
    return mask


@inlined
def nearest_by_search(
    kind: int,
    games: Games,
    game: int,
    own: int,
    teams: Teams,
    world: World,
    scratch: Any,
    settings: Any,
) -> int:
    """The same in a maze without a table; the queue of the look holds whom it heads for."""
    _, alert, look, stay_action = settings
    maze, path = np.int64(games.maze[game]), path_of(scratch)
    if kind == EVADER:
        threat, nearest = -1, np.int64(alert)
        for number in sought_by(kind, teams):
            cell = cell_of_sought(kind, games, game, number)
            if cell >= 0:
                distance = distance_within(world, path, maze, own, cell, nearest)
                if distance < nearest:
                    nearest, threat = distance, cell
        if threat < 0:
            return 0
        return mask_fleeing(world, scratch, maze, own, threat, alert + look, look, stay_action)
    targets, count = look_of(scratch).queue, 0
    for number in sought_by(kind, teams):
        cell = cell_of_sought(kind, games, game, number)
        if cell >= 0:
            targets[count] = cell
            count += 1
    return mask_towards(world, path, maze, own, targets, count)


@compiled
def choose_actions(
    kind: int,
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
    greedy: Any,
    scratch: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games] for the agent in `seat`.

    `counts` is (chasers, evaders, runners, goals); `settings` is (epsilon, alert distance, look
    radius, stay action). An epsilon of NaN in the game means that of the settings.
    """
    chasers, evaders, runners, goals = counts
    default, alert, _, stay_action = settings
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(chasers, evaders, runners, goals)
    world = world_of(mazes, neighbors, facts, tables)
    limit = np.int64(alert if kind == EVADER else FAR)
    for game in range(actions.shape[0]):
        maze, own = np.int64(games.maze[game]), np.int64(games.position[game, seat])
        if has_table(world, maze):
            mask = nearest_by_table(kind, games, game, own, limit, teams, world, greedy)
        else:
            mask = nearest_by_search(kind, games, game, own, teams, world, scratch, settings)
        every = legal_moves(world, maze, own)
        if mask == 0:
            mask = every
        epsilon = default if np.isnan(epsilon_of[game, seat]) else epsilon_of[game, seat]
        actions[game] = draw_action(
            mask, every, epsilon, stay_action, streams[game], stream_of(seat)
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
    alert: int,
    moves: Any,
) -> None:
    """Fill `moves` [games, 2] with the masks that `choose_actions` draws from: greedy, and every.

    Arguments are the same as there; all mazes have tables.
    """
    chasers, evaders, runners, goals = counts
    limit = np.int64(alert if kind == EVADER else FAR)
    games = Games(position, active, event, goal, steps, maze_of)
    teams = Teams(chasers, evaders, runners, goals)
    world = world_of(mazes, neighbors, facts, tables)
    for game in range(moves.shape[0]):
        maze, own = np.int64(games.maze[game]), np.int64(games.position[game, seat])
        mask = nearest_by_table(kind, games, game, own, limit, teams, world, greedy)
        every = legal_moves(world, maze, own)
        moves[game, 0], moves[game, 1] = mask if mask != 0 else every, every


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
