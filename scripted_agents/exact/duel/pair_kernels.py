"""Compiled kernels of `best_response`: sweeps over all pairs of cells of two players.

The players are *own* and *other*. A player has a *slot* for each move, if it changes the cell, and
a last one for staying (by the stay action, or by a move into a wall).

In a maze the cells of the other player are the full grid of rows × columns, with blocked cells.
Then the next cell of a move has the same offset everywhere, and a sweep is arithmetic on long rows,
which the processor vectorises. In a graph they are the cells, and `width` is 0. Arrays, all
float64:

    values   [own cell, width + grid + width]  with a margin of one row of cells at both ends
    chances  [own cell, slot, grid]            probabilities of the other's slots; 0 if own == other
    weights  [own cell, slot, grid]            probabilities of the own slots
    after    [slot, grid]                      for one own cell: expected values after each slot

"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import allocating, compiled, inlined, subroutine
from pursuit.rules.captures import Duel, ends_duel
from scripted_agents.exact.tolerances import TIE


class Pairs(NamedTuple):
    """A duel from the view of one player, against the table of the other.

    Attributes:
        chances: as above.
        neighbors: [cells, slots] int32, the cell after each move of the own player.
        around: [cells, any] int32, the cells that a move leads to or from, and the own cell in free
            places.
        spots: [cells] int32, the index of each cell in the grid.
        width: of the grid; 0 for a graph.
        duel: the rules of captures.
        stay_action: whether the own player may stay.
    """

    chances: Any
    neighbors: Any
    around: Any
    spots: Any
    width: int
    duel: Duel
    stay_action: bool


@compiled
def lay_out_table(table: Any, neighbors: Any, spots: Any, turned: bool, laid: Any) -> None:
    """Fill `laid` with a table as `weights`, or as `chances` if `turned`; sums are scaled to 1."""
    size, still = table.shape[0], laid.shape[1] - 1
    laid[:] = 0.0
    for own in range(size):
        for other in range(size):
            if own == other:
                continue
            self_cell, seen = (other, own) if turned else (own, other)
            total = 0.0
            for action in range(table.shape[2]):
                total += table[self_cell, seen, action]
            for action in range(table.shape[2]):
                cell = neighbors[self_cell, action]
                slot = action if cell != self_cell else still
                laid[own, slot, spots[other]] += table[self_cell, seen, action] / total


@subroutine
def has_slot(pairs: Pairs, own: int, slot: int) -> Any:
    """Whether the own player can use this slot in its cell."""
    still = pairs.neighbors.shape[1] - 1
    if slot != still:
        return pairs.neighbors[own, slot] != own
    stays = pairs.stay_action
    for action in range(still):
        stays |= pairs.neighbors[own, action] == own
    return stays


@subroutine
def mean_in_grid(row: Any, chance: Any, width: int, line: Any) -> None:
    """Fill `line` with the mean of a row of `values` over the other's moves in the grid."""
    grid = chance.shape[1]
    north, south, east, west, still = chance[0], chance[1], chance[2], chance[3], chance[4]
    row_north, row_south = row[:grid], row[2 * width :]
    row_east, row_west, row_still = row[width + 1 :], row[width - 1 :], row[width:]
    for spot in range(grid):
        line[spot] = (
            north[spot] * row_north[spot]
            + south[spot] * row_south[spot]
            + east[spot] * row_east[spot]
            + west[spot] * row_west[spot]
            + still[spot] * row_still[spot]
        )


@subroutine
def mean_in_graph(row: Any, chance: Any, neighbors: Any, line: Any) -> None:
    """Fill `line` with the mean of a row of `values` over the other's moves in a graph."""
    still = neighbors.shape[1] - 1
    for other in range(line.shape[0]):
        total = 0.0
        for slot in range(still):
            total += chance[slot, other] * row[neighbors[other, slot]]
        line[other] = total + chance[still, other] * row[other]


@subroutine
def look_ahead(values: Any, own: int, pairs: Pairs, after: Any) -> None:
    """Fill after[slot] with the mean of `values` after that own move, over the other's moves.

    Capture counts 0, and an own slot that does not exist counts infinity. Values of pairs in one
    cell are 0. All other captures are between cells `around`, so their means are computed
    separately.
    """
    neighbors, chances, spots = pairs.neighbors, pairs.chances, pairs.spots
    still = neighbors.shape[1] - 1
    for slot in range(still + 1):
        line = after[slot]
        if not has_slot(pairs, own, slot):
            line[:] = np.inf
            continue
        mine = own if slot == still else neighbors[own, slot]
        if pairs.width > 0:
            mean_in_grid(values[mine], chances[own], pairs.width, line)
        else:
            mean_in_graph(values[mine], chances[own], neighbors, line)
        row_still = values[mine, pairs.width :]
        for other in pairs.around[own]:
            if other == own:
                continue
            spot = spots[other]
            line[spot] = 0.0
            for their_slot in range(still + 1):
                theirs = other if their_slot == still else neighbors[other, their_slot]
                if not ends_duel(pairs.duel, own, mine, other, theirs):
                    line[spot] += chances[own, their_slot, spot] * row_still[spots[theirs]]


@subroutine
def finish(values: Any, own: int, pairs: Pairs, line: Any, target: Any, change: Any) -> None:
    """Write one row of new values, 0 for pairs in one cell, and update the largest changes."""
    line[pairs.spots[own]] = 0.0
    old, new = values[own, pairs.width :], target[own, pairs.width :]
    for spot in range(line.shape[0]):
        step = abs(line[spot] - old[spot])
        change[spot] = step if step > change[spot] else change[spot]
        new[spot] = line[spot]


@inlined
def largest(changes: Any) -> Any:
    """The largest of these numbers from 0 on; `max` of an array takes long to compile."""
    found = 0.0
    for change in changes:
        found = change if change > found else found
    return found


@allocating
def respond_rows(
    pairs: Pairs, step_cost: float, discount: float, values: Any, target: Any, first: int, last: int
) -> Any:
    """One step of backward induction (Bellman, 1957) for the own cells from `first` to `last` - 1.

    target = step_cost + discount * the least expected value over the own slots. For a maximising
    player the step cost is -1 and all values are negated. Returns the largest change.
    """
    after = np.empty(pairs.chances.shape[1:])
    change = np.zeros(after.shape[1])
    for own in range(first, last):
        look_ahead(values, own, pairs, after)
        least = after[0]
        for slot in range(1, after.shape[0]):
            line = after[slot]
            for spot in range(least.shape[0]):
                least[spot] = least[spot] if least[spot] < line[spot] else line[spot]
        for spot in range(least.shape[0]):
            least[spot] = step_cost + discount * least[spot]
        finish(values, own, pairs, least, target, change)
    return largest(change)


@allocating
def evaluate_rows(
    weights: Any, pairs: Pairs, discount: float, values: Any, target: Any, first: int, last: int
) -> Any:
    """As `respond_rows`, for an own player with slot probabilities `weights`, at step cost 1."""
    after = np.empty(pairs.chances.shape[1:])
    mean, change = np.empty(after.shape[1]), np.zeros(after.shape[1])
    for own in range(first, last):
        look_ahead(values, own, pairs, after)
        mean[:] = 1.0
        for slot in range(after.shape[0]):
            if has_slot(pairs, own, slot):
                line, weight = after[slot], weights[own, slot]
                for spot in range(mean.shape[0]):
                    mean[spot] += discount * weight[spot] * line[spot]
        finish(values, own, pairs, mean, target, change)
    return largest(change)


@allocating
def choose(values: Any, pairs: Pairs, actions: Any) -> None:
    """Fill actions[own cell, other cell] with the first optimal action, moves before staying.

    An agent stays by the stay action or, without it, by the first action into a wall.
    """
    after = np.empty(pairs.chances.shape[1:])
    for own in range(pairs.spots.shape[0]):
        still = pairs.neighbors.shape[1] - 1
        if not pairs.stay_action:
            for action in range(still - 1, -1, -1):
                if pairs.neighbors[own, action] == own:
                    still = action
        look_ahead(values, own, pairs, after)
        for other in range(pairs.spots.shape[0]):
            least, chosen = np.inf, still
            for slot in range(after.shape[0]):
                value = after[slot, pairs.spots[other]]
                if value < least and not value > least - TIE * abs(least):
                    least, chosen = value, still if slot == after.shape[0] - 1 else slot
            actions[own, other] = chosen


@compiled
def spread_capture(captured: Any, weights: Any, pairs: Pairs, for_all: bool) -> Any:
    """Mark pairs from which moves can lead to capture or to a marked pair; return whether any new.

    Only own slots with a positive weight count. One of them suffices; with `for_all` all must.
    `captured` is bool [own cell, other cell] with the diagonal marked.
    """
    neighbors, spots = pairs.neighbors, pairs.spots
    changed, last = False, neighbors.shape[1] - 1
    for own in range(captured.shape[0]):
        for other in range(captured.shape[0]):
            if captured[own, other]:
                continue
            result = for_all
            for slot in range(last + 1):
                if weights[own, slot, spots[other]] <= 0.0:
                    continue
                mine = own if slot == last else neighbors[own, slot]
                leads = False
                for their_slot in range(last + 1):
                    if pairs.chances[own, their_slot, spots[other]] > 0.0:
                        theirs = other if their_slot == last else neighbors[other, their_slot]
                        leads |= captured[mine, theirs]
                        leads |= ends_duel(pairs.duel, own, mine, other, theirs)
                if leads != for_all:
                    result = leads
                    break
            captured[own, other] = result
            changed |= result
    return changed
