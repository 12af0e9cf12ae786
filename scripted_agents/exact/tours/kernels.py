"""Compiled kernels of `tour`: the Held-Karp algorithm, and sums over all placements.

`between[i, j]` int32 is the path distance from i to j; 0 is the start, 1, 2, ... are the goals.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import allocating, compiled
from pursuit.rules.distances import moves_of, table_distance
from pursuit.rules.layout import FIRST_CELL, UNREACHABLE, Games, World
from pursuit.rules.randomness import next_below

FAR = 2**29


@compiled
def held_karp(between: Any, num_goals: Any, best: Any) -> Any:
    """The length of a shortest tour; `between` is [1 + goals, 1 + goals].

    Fills best[mask, last] with the length of the shortest path from the start through the goals in
    the bits of `mask` that ends at goal `last`; FAR if `last` is not among them.
    """
    for mask in range(1, 1 << num_goals):
        for last in range(num_goals):
            before = mask & ~(1 << last)
            if before == mask:
                best[mask, last] = FAR
            elif before == 0:
                best[mask, last] = between[0, last + 1]
            else:
                shortest = np.int32(FAR)
                for previous in range(num_goals):
                    shortest = min(
                        shortest, best[before, previous] + between[previous + 1, last + 1]
                    )
                best[mask, last] = shortest
    shortest = np.int32(FAR) if num_goals > 0 else np.int32(0)
    for last in range(num_goals):
        shortest = min(shortest, best[(1 << num_goals) - 1, last])
    return np.int64(shortest)


@compiled
def held_karp_order(between: Any, num_goals: int, best: Any, order: Any) -> None:
    """Fill `order` with the rows of `between` (1, 2, ...) in the order of a shortest tour."""
    mask, after = (1 << num_goals) - 1, 0
    for place in range(num_goals - 1, -1, -1):
        chosen, shortest = 0, 2 * FAR
        for last in range(num_goals):
            step = between[last + 1, after] if after > 0 else 0
            if best[mask, last] + step < shortest:
                chosen, shortest = last, best[mask, last] + step
        order[place] = after = chosen + 1
        mask &= ~(1 << chosen)


@allocating
def tours_by_table(table: Any, starts: Any, goals: Any, most: int, lengths: Any) -> None:
    """Fill `lengths` of placements with at most `most` goals; -1 if a goal is unreachable."""
    cells = np.empty(most + 1, dtype=np.int64)
    between = np.empty((most + 1, most + 1), dtype=np.int32)
    best = np.empty((1 << most, most), dtype=np.int32)
    for game in range(starts.shape[0]):
        cells[0] = starts[game]
        count = np.int64(0)
        for goal in goals[game]:
            listed = goal < 0
            for i in range(count + 1):
                listed |= goal == cells[i]
            if not listed:
                count += 1
                cells[count] = goal
        reachable = True
        for i in range(count + 1):
            for j in range(count + 1):
                between[i, j] = table[cells[i], cells[j]]
                reachable &= between[i, j] != UNREACHABLE
        lengths[game] = held_karp(between, count, best) if reachable else -1


@allocating
def draw_placements(num_cells: int, streams: Any, placements: Any) -> None:
    """Fill each row with distinct uniformly random cells (a partial Fisher-Yates shuffle)."""
    cells = np.arange(num_cells)
    for sample in range(placements.shape[0]):
        for i in range(placements.shape[1]):
            chosen = i + next_below(streams, 0, num_cells - i)
            cells[i], cells[chosen] = cells[chosen], cells[i]
            placements[sample, i] = cells[i]


@compiled
def sum_of_tours(table: Any, num_goals: int) -> int:
    """The sum of the shortest tours over all placements of a start and 1 to 3 unordered goals."""
    size = table.shape[0]
    total = 0
    for a in range(size):
        if num_goals == 1:
            for start in range(size):
                total += table[a, start]
        for b in range(a + 1, size if num_goals > 1 else 0):
            row_a, row_b = table[a], table[b]
            ab = row_a[b]
            if num_goals == 2:
                part = np.int32(0)
                for start in range(size):
                    part += ab + min(row_a[start], row_b[start])
                total += part - 2 * ab  # minus the starts on a goal
                continue
            for c in range(b + 1, size):
                row_c = table[c]
                ac, bc = row_a[c], row_b[c]
                # The length of the tour after the first goal.
                from_a, from_b, from_c = bc + min(ab, ac), ac + min(ab, bc), ab + min(ac, bc)
                part = np.int32(0)
                for start in range(size):
                    part += min(row_a[start] + from_a, row_b[start] + from_b, row_c[start] + from_c)
                part -= min(from_a, ab + from_b, ac + from_c)
                part -= min(ab + from_a, from_b, bc + from_c)
                part -= min(ac + from_a, bc + from_b, from_c)
                total += part
    return total


@compiled
def first_of_tour(between: Any, num_goals: int, best: Any) -> int:
    """The row of `between` (1, 2, ...) of the goal that a shortest tour visits first.

    Here `between[i, j]` is the distance from j to i, as the tour is found from its end.

    Ties are broken by the order of goals, so moves towards the result never change it. Overwrites
    row 0.
    """
    # Reversed tours, from any goal to the start; the distances to it are in column 0.
    between[0, :] = 0
    held_karp(between, num_goals, best)
    chosen, shortest = 0, 2 * FAR
    for goal in range(num_goals):
        length = between[goal + 1, 0] + best[(1 << num_goals) - 1, goal]
        if length < shortest:
            chosen, shortest = goal + 1, length
    return chosen


@compiled
def plan_next_goals(games: Games, seat: int, world: World, plans: Any, scratch: Any) -> None:
    """Find the next goal of a shortest tour in every game, from the cached plan while it is valid.

    `plans` are `runner.Plans`. `scratch` is scratch memory: [1 << goals, goals] and [1 + goals,
    1 + goals] int32, [1 + goals] int64. The rest of a shortest tour is a shortest tour, so a plan
    is computed only if goals changed or the agent left the tour.
    """
    next_goal, last_maze, last_own, last_goals = plans
    best, between, cells = scratch
    num_goals = games.goal.shape[1]
    for game in range(next_goal.shape[0]):
        maze, own = np.int64(games.maze[game]), np.int64(games.position[game, seat])
        aim, before = np.int64(next_goal[game]), np.int64(last_own[game])
        valid = last_maze[game] == maze and aim >= 0
        if valid:
            walked = table_distance(world, maze, before, own)
            rest = table_distance(world, maze, own, aim)
            valid = walked + rest == table_distance(world, maze, before, aim)
        count = 0
        cells[0] = own
        for number in range(num_goals):
            cell = np.int64(games.goal[game, number])
            valid &= last_goals[game, number] == cell
            last_goals[game, number] = cell
            if cell >= 0:
                count += 1
                cells[count] = cell
        last_maze[game], last_own[game] = maze, own
        if valid:
            continue
        for i in range(count + 1):
            for j in range(count + 1):
                between[i, j] = table_distance(world, maze, cells[j], cells[i])
        next_goal[game] = -1
        if count > 0:
            next_goal[game] = cells[first_of_tour(between, count, best)]


@allocating
def list_first_moves(games: Games, seat: int, world: World, first_moves: Any) -> None:
    """Set in `first_moves` [games, actions] bool all moves with which a shortest tour begins.

    One table of reversed tours holds the rest of the tour from each goal on, and so the tours from
    all neighbouring cells.
    """
    num_goals, moves = games.goal.shape[1], moves_of(world.neighbors)
    cells = np.empty(num_goals, dtype=np.int64)
    between = np.zeros((1 + num_goals, 1 + num_goals), dtype=np.int32)
    best = np.empty((1 << num_goals, num_goals), dtype=np.int32)
    lengths = np.empty(len(moves), dtype=np.int64)
    for game in range(first_moves.shape[0]):
        maze, own, count = np.int64(games.maze[game]), games.position[game, seat], 0
        for cell in games.goal[game]:
            if cell >= 0:
                cells[count] = cell
                count += 1
        for i in range(count):
            for j in range(count):
                between[i + 1, j + 1] = table_distance(world, maze, cells[j], cells[i])
        held_karp(between, count, best)
        lengths[:] = FAR
        for action in moves:
            cell = np.int64(world.neighbors[world.mazes[FIRST_CELL, maze] + own, action])
            for goal in range(count if cell != own else 0):
                rest = best[(1 << count) - 1, goal]
                length = table_distance(world, maze, cell, cells[goal]) + rest
                lengths[action] = min(lengths[action], length)
        for action in moves:
            first_moves[game, action] = lengths[action] == lengths.min() < FAR
