"""The decisions of the scripted agents, compiled: which moves are greedy, and which one is taken.

A set of moves is a bit mask over the actions. The same functions fill the tables of exact
probabilities and act in the batch, so that what is solved exactly is what plays.

`scratch` is int32 [4, cells of the largest maze], rows 0 and 2 all -1; only mazes without a
distance table use rows 2 and 3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit import rules
from pursuit.compiled import compiled, inlined

CHASER, EVADER, RUNNER, RANDOM = range(4)
FAR = 2**30

_MASKS = [[action for action in range(5) if mask >> action & 1] for mask in range(32)]
MASK_SIZE = np.array([len(actions) for actions in _MASKS])
MASK_ITEM = np.array([actions + [0] * (5 - len(actions)) for actions in _MASKS])


@inlined
def draw_action(
    greedy: int, every: int, epsilon: float, stay_action: bool, streams: Any, game: int, stream: int
) -> int:
    """A uniformly random action of the mask `greedy`, or, with probability `epsilon`, of `every`.

    One random word serves both draws. Staying, or a bump, where the mask is empty.
    """
    word = rules.next_word(streams[game], stream)
    mask = greedy
    if np.float64(word >> np.uint64(32)) * 2.0**-32 < epsilon:
        mask = every
    if mask == 0:
        return 4 if stay_action else 0
    chosen = ((word & np.uint64(0xFFFFFFFF)) * np.uint64(MASK_SIZE[mask])) >> np.uint64(32)
    return np.int64(MASK_ITEM[mask, np.int64(chosen)])


@compiled
def mask_towards(
    mazes: Any, cells: Any, scratch: Any, maze: int, own: int, targets: Any, count: int
) -> int:
    """First steps of shortest paths to the nearest of `targets[:count]`; 0 if there is none.

    One breadth-first search from all targets at once, until it comes to one's own cell.
    """
    offset = mazes[maze, rules.CELL_OFFSET]
    head = tail = 0
    for i in range(count):
        if scratch[2, targets[i]] < 0:
            scratch[2, targets[i]] = 0
            scratch[3, tail] = targets[i]
            tail += 1
    while head < tail:
        cell = scratch[3, head]
        head += 1
        if cell == own:
            break
        for action in range(4):
            after = cells[offset + cell, action]
            if scratch[2, after] < 0:
                scratch[2, after] = scratch[2, cell] + 1
                scratch[3, tail] = after
                tail += 1
    mask, nearest = 0, scratch[2, own]
    if nearest > 0:
        for action in range(4):
            if scratch[2, cells[offset + own, action]] == nearest - 1:
                mask |= 1 << action
    rules.forget(scratch[2:], tail)
    return mask


@compiled
def mask_fleeing(
    mazes: Any,
    cells: Any,
    tables: Any,
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
    offset = mazes[maze, 0]
    seen = rules.search_within(cells, offset, own, look_radius, -1, scratch)
    farthest = own_distance = rules.distance_within(
        mazes, cells, tables, scratch[2:], maze, own, threat, reach
    )
    for i in range(seen):
        farthest = max(
            farthest,
            rules.distance_within(
                mazes, cells, tables, scratch[2:], maze, scratch[1, i], threat, reach
            ),
        )
    mask = 0
    if farthest == own_distance:
        mask = 1 << 4 if stay_action else np.int64(cells[offset + own, rules.MOVE_MASK])
    else:
        for i in range(seen):
            cell = scratch[1, i]
            if farthest != rules.distance_within(
                mazes, cells, tables, scratch[2:], maze, cell, threat, reach
            ):
                continue
            steps = np.int64(scratch[0, cell])
            for action in range(4):
                after = cells[offset + own, action]
                if after != own and not mask >> action & 1:
                    rest = rules.distance_within(
                        mazes, cells, tables, scratch[2:], maze, after, cell, steps
                    )
                    if rest == steps - 1:
                        mask |= 1 << action
    rules.forget(scratch, seen)
    return mask


@compiled
def fill_greedy_table(
    kind: int,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
    alert_distance: int,
    look_radius: int,
    stay_action: bool,
    greedy: Any,
) -> None:
    """Fill `greedy`, laid out as `tables`: the mask at [own, other]; 0 where any move will do."""
    reach = alert_distance + look_radius
    for maze in range(mazes.shape[0]):
        offset, size, table = mazes[maze, 0], mazes[maze, 1], mazes[maze, 2]
        if table < 0:
            continue
        for own in range(size):
            for other in range(size):
                mask, distance = 0, np.int64(tables[table + own * size + other])
                if kind == EVADER and 0 < distance < alert_distance:
                    mask = mask_fleeing(
                        mazes,
                        cells,
                        tables,
                        scratch,
                        maze,
                        own,
                        other,
                        reach,
                        look_radius,
                        stay_action,
                    )
                elif kind != EVADER:
                    for action in range(4):
                        after = cells[offset + own, action]
                        if tables[table + after * size + other] == distance - 1:
                            mask |= 1 << action
                greedy[table + own * size + other] = mask


@compiled
def choose_actions(
    kind: int,
    rows: Any,
    streams: Any,
    epsilons: Any,
    seat: int,
    counts: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    greedy: Any,
    scratch: Any,
    targets: Any,
    settings: Any,
    actions: Any,
) -> None:
    """Fill `actions` [games] for the agent in `seat`.

    `counts` is (chasers, evaders, runners, goals); `settings` is (epsilon, alert distance, look
    radius, stay action); `targets` is int32 scratch for the cells to head for. An epsilon of NaN
    in the game means that of the settings.
    """
    num_agents = counts[0] + counts[1] + counts[2]
    default, alert, look, stay_action = settings
    first, last = counts[0], counts[0] + counts[1]  # what a chaser heads for: evaders
    if kind == EVADER:
        first, last = 0, counts[0]
    elif kind == RUNNER:
        first, last = 3 * num_agents, 3 * num_agents + counts[3]
    elif kind == RANDOM:
        first, last = 0, 0
    for game in range(rows.shape[0]):
        maze, own = np.int64(rows[game, -1]), np.int64(rows[game, seat])
        offset, size, table = mazes[maze, 0], mazes[maze, 1], mazes[maze, 2]
        epsilon = default if np.isnan(epsilons[game, seat]) else epsilons[game, seat]
        mask, count = 0, 0
        nearest = np.int64(alert if kind == EVADER else FAR)
        for other in range(first, last):
            if rows[game, other] < 0 or (other < num_agents and not rows[game, num_agents + other]):
                continue
            if table >= 0:
                pair = table + own * size + rows[game, other]
                distance = np.int64(tables[pair])
                if distance < nearest:
                    nearest, mask = distance, np.int64(greedy[pair])
                elif distance == nearest and kind != EVADER:
                    mask |= np.int64(greedy[pair])
            elif kind == EVADER:
                distance = rules.distance_within(
                    mazes, cells, tables, scratch[2:], maze, own, rows[game, other], nearest
                )
                if distance < nearest:
                    nearest, count = distance, 1
                    targets[0] = rows[game, other]
            else:
                targets[count] = rows[game, other]
                count += 1
        if count > 0 and kind == EVADER:
            mask = mask_fleeing(
                mazes,
                cells,
                tables,
                scratch,
                maze,
                own,
                targets[0],
                alert + look,
                look,
                stay_action,
            )
        elif count > 0:
            mask = mask_towards(mazes, cells, scratch, maze, own, targets, count)
        every = np.int64(cells[offset + own, rules.MOVE_MASK])
        if mask == 0:
            mask = every
        actions[game] = draw_action(mask, every, epsilon, stay_action, streams, game, 1 + seat)


@compiled
def sample_table(
    rows: Any,
    streams: Any,
    epsilons: Any,
    seat: int,
    opponents: Any,
    num_agents: int,
    mazes: Any,
    cells: Any,
    cumulative: Any,
    table_offsets: Any,
    default: float,
    actions: Any,
) -> None:
    """Fill `actions` [games] from a policy table, given as cumulative sums over the actions.

    The other cell is that of the first active opponent. `cumulative` is [all pairs, actions], the
    pairs of maze m beginning at `table_offsets[m]`.
    """
    num_actions = cumulative.shape[1]
    for game in range(rows.shape[0]):
        actions[game] = 0
        maze, own = np.int64(rows[game, -1]), np.int64(rows[game, seat])
        other = np.int64(-1)
        for i in range(opponents.shape[0]):
            if other < 0 and rows[game, num_agents + opponents[i]]:
                other = np.int64(rows[game, opponents[i]])
        if other < 0 or not rows[game, num_agents + seat]:
            continue
        epsilon = epsilons[game, seat]
        if np.isnan(epsilon):
            epsilon = default
        if epsilon > 0.0 and rules.next_uniform(streams[game], 1 + seat) < epsilon:
            every = np.int64(cells[mazes[maze, 0] + own, rules.MOVE_MASK])
            actions[game] = draw_action(
                every, every, 0.0, num_actions == 5, streams, game, 1 + seat
            )
            continue
        pair = table_offsets[maze] + own * mazes[maze, 1] + other
        draw = rules.next_uniform(streams[game], 1 + seat) * cumulative[pair, num_actions - 1]
        while actions[game] < num_actions - 1 and draw >= cumulative[pair, actions[game]]:
            actions[game] += 1
