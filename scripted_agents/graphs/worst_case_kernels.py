"""Compiled breadth-first search over what may be contaminated: plans that surely find an evader.

A *state* is a place and a set. The place is the number whose digits, in base of the cells, are the
searchers' cells in ascending order, the first counting fastest; the set holds, as bits, the cells
in which the evader may be. Of two states at one place the one whose set is within the other's is at
least as good; if it is not later as well, the other is dropped.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import compiled, inlined

DEAD = -2
"""In place of what comes next of a state that another of its step has replaced."""

END = -1

NOTHING, FOUND, FULL = -1, -2, -3


class World(NamedTuple):
    """The maze; sets of cells are uint64, a bit a cell.

    Attributes:
        moves: [cells, 5] int64, the cells after a step of a searcher, `num_moves` [cells] of them.
        reach, came_from: [cells], where an evader can go to and come from in a step.
        sight: [cells], what is in view.
        fast: whether an evader runs on, out of view.
    """

    moves: Any
    num_moves: Any
    reach: Any
    came_from: Any
    sight: Any
    fast: bool


class States(NamedTuple):
    """All states: `heads` [places] and `links` [states] int32 chain those of a place; and of each
    its place, its set and the state before it.
    """

    heads: Any
    links: Any
    places: Any
    sets: Any
    parents: Any


@inlined
def bit(cell: int) -> Any:
    """The set of one cell."""
    return np.uint64(1) << np.uint64(cell)


@inlined
def lowest(cells: Any) -> int:
    """The first cell of a set that is not empty."""
    # The bits below the lowest one, counted.
    below = (cells & (~cells + np.uint64(1))) - np.uint64(1)
    count = 0
    for half in (32, 16, 8, 4, 2, 1):
        if below >> np.uint64(half - 1) & np.uint64(1):
            count += half
            below >>= np.uint64(half)
    return count


@inlined
def spread(cells: Any, reach: Any) -> Any:
    """Where an evader can be, one move after it was somewhere in `cells`."""
    after = np.uint64(0)
    while cells:
        cell = lowest(cells)
        cells &= cells - np.uint64(1)
        after |= reach[cell]
    return after


@inlined
def contaminated_after(cells: Any, spreading: Any, before: Any, now: Any, world: World) -> Any:
    """Where the evader may be after searchers went from `before` to `now`.

    `spreading` is `spread(cells)`. A fast evader then runs on, out of view.
    """
    seen = np.uint64(0)
    for i in range(now.shape[0]):
        seen |= world.sight[now[i]]
    after = spreading & ~seen
    for i in range(before.shape[0]):
        # Whoever goes where a searcher comes from, while that one comes to meet it, is caught.
        free = cells & world.came_from[before[i]]
        for j in range(before.shape[0]):
            if before[j] == before[i]:
                free &= ~bit(now[j])
        if not free:
            after &= ~bit(before[i])
    if world.fast:
        more = after
        while more:
            more = spread(more, world.reach) & ~seen & ~after
            after |= more
    return after


@compiled
def leads_to(cells: Any, before: Any, now: Any, world: Any, after: Any) -> Any:
    """Whether the set after searchers went from `before` to `now` is `after`."""
    spreading = spread(cells, world.reach)
    return after == contaminated_after(cells, spreading, before, now, world)


@inlined
def place_of(cells: Any, ordered: Any, size: int) -> int:
    """The number of a place of searchers in these cells, in any order."""
    for i in range(cells.shape[0]):
        cell, at = cells[i], i
        while at > 0 and ordered[at - 1] > cell:
            ordered[at] = ordered[at - 1]
            at -= 1
        ordered[at] = cell
    place = 0
    for i in range(cells.shape[0] - 1, -1, -1):
        place = place * size + ordered[i]
    return place


@inlined
def keep(place: int, cells: Any, parent: int, count: int, level: int, states: States) -> int:
    """Add a state, unless one that is as good is there; how many there are then.

    States from `level` on are of the same step: the new one replaces those that it is as good as.
    """
    heads, links, sets = states.heads, states.links, states.sets
    before, at = END, heads[place]
    while at != END:
        if sets[at] & ~cells == np.uint64(0):
            return count
        after = links[at]
        if cells & ~sets[at] == np.uint64(0):
            if before == END:
                heads[place] = after
            else:
                links[before] = after
            if at >= level:
                links[at] = DEAD
        else:
            before = at
        at = after
    states.places[count], sets[count], states.parents[count] = place, cells, parent
    links[count], heads[place] = heads[place], count
    return count + 1


@compiled
def begin(starts: Any, every: Any, world: Any, states: Any, ordered: Any) -> Any:
    """The states of step 0, of searchers in `starts` [places, searchers]; how many."""
    count, size = 0, world.sight.shape[0]
    for start in range(starts.shape[0]):
        seen = np.uint64(0)
        for i in range(starts.shape[1]):
            seen |= world.sight[starts[start, i]]
        place = place_of(starts[start], ordered, size)
        count = keep(place, every & ~seen, -1, count, 0, states)
    return count


@compiled
def expand(
    first: int, last: int, count: int, world: Any, states: Any, room: Any, answer: Any
) -> None:
    """Add what follows on the states from `first` to `last` - 1, all of one step.

    `room` is int64 [4, searchers]. Writes (NOTHING, FOUND or FULL; the first state that is not
    done; how many states there are) into `answer` [3]. The last state of FOUND is one with nothing
    contaminated.
    """
    before, now, digits, ordered = room[0], room[1], room[2], room[3]
    searchers, size = room.shape[1], world.sight.shape[0]
    for state in range(first, last):
        if states.links[state] == DEAD:
            continue
        place, joint = states.places[state], 1
        for i in range(searchers):
            before[i] = place % size
            place //= size
            joint *= world.num_moves[before[i]]
            digits[i] = 0
        if count + joint > states.sets.shape[0]:
            answer[0], answer[1], answer[2] = FULL, state, count
            return
        cells = states.sets[state]
        spreading = spread(cells, world.reach)
        for _ in range(joint):
            for i in range(searchers):
                now[i] = world.moves[before[i], digits[i]]
            after = contaminated_after(cells, spreading, before, now, world)
            place = place_of(now, ordered, size)
            if not after:
                states.places[count], states.sets[count] = place, after
                states.parents[count] = state
                answer[0], answer[1], answer[2] = FOUND, state, count + 1
                return
            count = keep(place, after, state, count, last, states)
            for i in range(searchers):
                digits[i] += 1
                if digits[i] < world.num_moves[before[i]]:
                    break
                digits[i] = 0
    answer[0], answer[1], answer[2] = NOTHING, last, count
