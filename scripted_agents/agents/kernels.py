"""Compiled decisions of the scripted agents: the sets of greedy moves, and the choice among them.

A set of moves is a bit mask over the actions. The same functions fill the tables of exact
probabilities and act in batches, so exact solutions are those of the agents as simulated. Kernels
that act take the arrays of games and mazes as separate arguments, which is faster to call.
`scratch` is int32 [NUM_SCRATCH, cells of the largest maze], scratch memory of three searches, with
-1 in its rows of distances.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined, subroutine
from pursuit.rules.distances import (
    FAR,
    begin_field,
    distance_within,
    forget,
    has_table,
    moves_down,
    moves_of,
    pair_index,
    search_within,
    spread_field,
    table_distance,
)
from pursuit.rules.layout import (
    DIRECTED,
    FIRST_CELL,
    NUM_CELLS,
    Games,
    Search,
    Teams,
    World,
    chasers_of,
    evaders_of,
    goals_of,
    stay_of,
    stream_of,
)
from pursuit.rules.lookups import away_from_nearest, towards_nearest, write_action
from pursuit.rules.randomness import draw_action
from pursuit.rules.turn import legal_moves

CHASER, EVADER, RUNNER, RANDOM = range(4)
(
    LOOK_DISTANCE, LOOK_QUEUE, PATH_DISTANCE, PATH_QUEUE, FIELD_DISTANCE, FIELD_QUEUE, FIELD_OWNER,
    TARGETS, NUM_SCRATCH,
) = range(9)  # fmt: skip
PAIRS_A_CELL = 8
"""The time of a search per cell, in lookups of pairs."""


@subroutine
def mask_fleeing(
    world: World, scratch: Any, maze: int, own: int, threat: int, settings: Any
) -> int:
    """First steps of shortest paths to the cells within the look radius farthest from `threat`.

    If no cell is farther than the own cell: staying if that is an action, else every move.
    `threat` is another cell, nearer than the alert distance; `settings` as of `fill_greedy_table`.
    """
    _, alert, look_radius, stay_action = settings
    reach = alert + look_radius  # at least the distance between `threat` and any of these cells
    look = Search(scratch[LOOK_DISTANCE], scratch[LOOK_QUEUE])  # around the agent
    path = Search(scratch[PATH_DISTANCE], scratch[PATH_QUEUE])
    seen = search_within(world, maze, own, look_radius, -1, look)
    farthest = own_distance = distance_within(world, path, maze, threat, own, reach)
    for i in range(seen):
        away = distance_within(world, path, maze, threat, look.queue[i], reach)
        farthest = max(farthest, away)
    mask = 0
    if farthest == own_distance:
        mask = 1 << stay_of(world.neighbors) if stay_action else legal_moves(world, maze, own)
    else:
        for i in range(seen):
            cell = look.queue[i]
            if farthest != distance_within(world, path, maze, threat, cell, reach):
                continue
            steps = np.int64(look.distance[cell])
            for action in moves_of(world.neighbors):
                after = world.neighbors[world.mazes[FIRST_CELL, maze] + own, action]
                if after != own and not mask >> action & 1:
                    rest = distance_within(world, path, maze, after, cell, steps)
                    if rest == steps - 1:
                        mask |= 1 << action
    forget(look, seen)
    return mask


@inlined
def first_steps(world: World, maze: Any, own: Any, target: Any) -> Any:
    """The bit mask of the first steps of shortest paths to another cell; 0 if there is no path."""
    distance: Any = table_distance(world, maze, own, target)
    mask: Any = 0
    for action in moves_of(world.neighbors):
        after = world.neighbors[world.mazes[FIRST_CELL, maze] + own, action]
        if table_distance(world, maze, after, target) == distance - 1:
            mask |= 1 << action
    return mask


@compiled
def fill_greedy_table(kind: int, world: World, scratch: Any, settings: Any, greedy: Any) -> None:
    """Fill `greedy` with the mask at [own, other], in the layout of `tables`; by default all moves.

    `settings` is (epsilon, alert distance, look radius, stay action).
    """
    alert = settings[1]
    for maze in range(world.mazes.shape[1]):
        if not has_table(world, maze):
            continue
        for own in range(world.mazes[NUM_CELLS, maze]):
            for other in range(world.mazes[NUM_CELLS, maze]):
                mask: Any = 0
                if kind == EVADER and 0 < table_distance(world, maze, other, own) < alert:
                    mask = mask_fleeing(world, scratch, maze, own, other, settings)
                elif kind != EVADER:
                    mask = first_steps(world, maze, own, other)
                if mask == 0:
                    mask = legal_moves(world, maze, own)
                greedy[pair_index(world, maze, own, other)] = mask


@inlined
def targets_of(kind: int, teams: Teams) -> Any:
    """The indices of the targets of a kind: agents or goals that it approaches or avoids."""
    if kind == CHASER:
        return evaders_of(teams)
    if kind == EVADER:
        return chasers_of(teams)
    return goals_of(teams) if kind == RUNNER else range(0, 0)


@inlined
def list_targets(kind: int, games: Games, game: int, teams: Teams, cells: Any) -> int:
    """Fill `cells` with those of the remaining targets by index; return their number."""
    count = 0
    for number in targets_of(kind, teams):
        count = add_target(kind, games, game, np.uint64(number), cells, count)
    return count


@inlined
def add_target(kind: int, games: Games, game: Any, target: Any, cells: Any, count: Any) -> Any:
    """Write the cell of a target to `cells[count]`; return the number of cells, with this one if it
    remains."""
    if kind == RUNNER:
        cells[np.uint64(count)] = games.goal[game, target]
        count += games.goal[game, target] >= 0
    else:
        cells[np.uint64(count)] = games.position[game, target]
        count += games.active[game, target] != 0
    return count


@inlined
def moves_away(
    world: World, maze: int, own: int, threat: int, greedy: Any, scratch: Any, settings: Any
) -> int:
    """The moves of an evader; `threat` is the cell of its nearest chaser."""
    if has_table(world, maze):
        return np.int64(greedy[pair_index(world, maze, own, threat)])
    return mask_fleeing(world, scratch, maze, own, threat, settings)


@inlined
def use_table(world: World, maze: int, pairs: int) -> bool:
    """Whether looking up so many pairs is faster than a search, which visits every cell once.

    A search starts at the targets, so directed graphs always use the table.
    """
    few = pairs <= PAIRS_A_CELL * world.mazes[NUM_CELLS, maze]
    return has_table(world, maze) and (few or world.mazes[DIRECTED, maze] != 0)


@compiled
def list_moves(
    kind: int, games: Games, seat: int, counts: Any, world: World, greedy: Any, targets: Any,
    moves: Any,
) -> None:  # fmt: skip
    """Fill `moves` [games, 2] with the masks that actions are drawn from: greedy, and every move.

    Arguments as of the kernels of `entry_for`; `targets` is scratch memory for all agents or goals.
    All mazes must have tables.
    """
    teams = Teams(counts[0], counts[1], counts[2], counts[3])
    for game in range(moves.shape[0]):
        row, mask = np.uint64(game), np.int64(0)
        maze, own = np.int64(games.maze[row]), np.int64(games.position[row, np.uint64(seat)])
        count = list_targets(kind, games, row, teams, targets)
        if kind == EVADER:
            mask = away_from_nearest(world, maze, own, targets, count, greedy)
        elif kind != RANDOM:
            mask = towards_nearest(world, maze, own, targets, count, greedy)
        every = legal_moves(world, maze, own)
        moves[game, 0], moves[game, 1] = every if mask == 0 else mask, every


@compiled
def draw_moves(
    games: Games, streams: Any, epsilon_of: Any, seat: int, world: World, masks: Any, settings: Any,
    actions: Any,
) -> None:  # fmt: skip
    """Fill `actions` [games] with draws from `masks` [games]; a mask of 0 stands for every move.

    `settings` is (epsilon, stay action). Its epsilon applies where that of the game is NaN.
    """
    default, stay_action = settings
    empty = stay_of(world.neighbors) * np.int64(stay_action)
    for game in range(actions.shape[0]):
        every = legal_moves(world, np.int64(games.maze[game]), np.int64(games.position[game, seat]))
        mask, epsilon = np.int64(masks[game]), epsilon_of[game, seat]
        greedy, stream = every if mask == 0 else mask, stream_of(seat)
        share = default if np.isnan(epsilon) else epsilon
        actions[game] = draw_action(greedy, every, share, empty, False, streams[game], stream)


def entry_for(kind: int) -> Any:
    """The kernel that chooses the actions of all agents of one kind."""

    @compiled
    def choose_actions(
        position: Any, active: Any, event: Any, goal: Any, steps: Any, maze_of: Any, exit_of: Any,
        streams: Any, epsilon_of: Any, seats: Any, columns: Any, counts: Any, mazes: Any,
        neighbors: Any, facts: Any, tables: Any, greedy: Any, scratch: Any, settings: Any,
        actions: Any,
    ) -> None:  # fmt: skip
        """Fill `columns` of `actions` [games, any] for the agents in `seats`, both [agents] int64.

        `counts` is (chasers, evaders, runners, goals); `settings` is (epsilon, alert distance, look
        radius, stay action), and its epsilon applies where that of the game is NaN. Captured
        evaders choose actions as well, which is faster than a check.

        Targets are listed once per game. A few distances are looked up. For many agents and targets
        one search from all targets is faster: its time grows with agents plus cells.
        """
        default, alert, _, stay_action = settings
        games = Games(position, active, event, goal, steps, maze_of, exit_of)
        teams = Teams(counts[0], counts[1], counts[2], counts[3])
        world = World(mazes, neighbors, facts, tables)
        empty = stay_of(world.neighbors) * np.int64(stay_action)
        field = Search(scratch[FIELD_DISTANCE], scratch[FIELD_QUEUE])  # from all targets
        owner, targets = scratch[FIELD_OWNER], scratch[TARGETS]
        for game in range(actions.shape[0]):
            maze, row = np.int64(games.maze[np.uint64(game)]), np.uint64(game)
            head = tail = 0
            count = list_targets(kind, games, row, teams, targets)
            by_table = use_table(world, maze, count * seats.shape[0])
            if not by_table and kind != RANDOM:
                tail = begin_field(field, owner, targets, count)
                if kind == EVADER:
                    head, tail = spread_field(world, maze, field, owner, -1, alert - 1, head, tail)
            for i in range(seats.shape[0]):
                seat = np.uint64(seats[np.uint64(i)])
                own, mask = np.int64(games.position[row, seat]), np.int64(0)
                if by_table and kind == EVADER:
                    mask = away_from_nearest(world, maze, own, targets, count, greedy)
                elif by_table:
                    mask = towards_nearest(world, maze, own, targets, count, greedy)
                elif kind == EVADER:
                    if 0 < field.distance[own] < alert:
                        threat = np.int64(targets[owner[own]])
                        mask = moves_away(world, maze, own, threat, greedy, scratch, settings)
                elif kind != RANDOM:
                    head, tail = spread_field(world, maze, field, owner, own, FAR, head, tail)
                    mask = moves_down(world, maze, field, own)
                every = legal_moves(world, maze, own)
                column, share = np.uint64(columns[np.uint64(i)]), epsilon_of[row, seat]
                write_action(
                    actions, row, column, mask, every, share, default, empty, False, streams, seat
                )
            forget(field, tail)

    return choose_actions


ENTRIES = {kind: entry_for(kind) for kind in (CHASER, EVADER, RUNNER, RANDOM)}
"""The kernels by kind, each compiled at its first call."""
