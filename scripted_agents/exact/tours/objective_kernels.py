"""Compiled kernels of `objective`: tours with the best discounted return, over all sets of goals.

Sets of goals are numbered in the combinatorial number system: the set c1 < c2 < ... has the number
C(c1, 1) + C(c2, 2) + ...
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import allocating, inlined, subroutine
from scripted_agents.exact.tolerances import TIE


class GoalPaths(NamedTuple):
    """The shortest paths from every cell to every goal.

    Attributes:
        distances: [goal, cell] int16, steps.
        rewards: [goal, cell] float64, the discounted reward of the path.
        shrinks: [goal, cell] float64, the discount of the rewards after it.
        binomials: [cells + 1, goals + 1] int64.
    """

    distances: Any
    rewards: Any
    shrinks: Any
    binomials: Any


class Layer(NamedTuple):
    """Results for all sets of goals of one size, from every cell outside of the set.

    Attributes:
        values: [sets, cells] float64, return of the best tour.
        lengths: [sets, cells] int16, length of that tour.
        shortest: [sets, cells] int16, length of the shortest tour.
    """

    values: Any
    lengths: Any
    shortest: Any


@inlined
def next_set(goals: Any, count: int, cells: int) -> Any:
    """Change `goals` to the set with the next number; return whether there is one."""
    i = 0
    while i < count - 1 and goals[i] + 1 == goals[i + 1]:
        goals[i] = i
        i += 1
    goals[i] += 1
    return goals[count - 1] < cells


@inlined
def number_without(goals: Any, count: int, removed: int, binomials: Any) -> Any:
    """The number of the set without `goals[removed]`."""
    number = np.int64(0)
    for i in range(count):
        if i != removed:
            number += binomials[goals[i], i + 1 if i < removed else i]
    return number


@subroutine
def fill_set(goals: Any, count: int, ways: Any, before: Any, found: Any) -> None:
    """Fill `found`, the rows [cells] of one set of `count` goals, from the layer below."""
    cells = ways.distances.shape[0]
    value, long, short = found.values, found.lengths, found.shortest
    value[:] = -np.inf
    long[:] = 0
    short[:] = 32767
    for i in range(count):
        goal = goals[i]
        rest = number_without(goals, count, i, ways.binomials)
        after, then = before.values[rest, goal], before.lengths[rest, goal]
        least = before.shortest[rest, goal]
        for cell in range(cells):
            way = ways.distances[goal, cell]
            gain = ways.rewards[goal, cell] + ways.shrinks[goal, cell] * after
            length = way + then
            margin = TIE * (1.0 + abs(gain))
            better = gain > value[cell] + margin
            as_good = gain >= value[cell] - margin
            if better or (as_good and length < long[cell]):
                long[cell] = length
            value[cell] = gain if gain > value[cell] else value[cell]
            short[cell] = min(short[cell], way + least)


@allocating
def one_goal_more(count: int, ways: Any, before: Any, layer: Any) -> None:
    """Fill the layer of sets of `count` goals from the layer with one goal less."""
    goals = np.arange(count)
    for number in range(layer.values.shape[0]):
        found = Layer(layer.values[number], layer.lengths[number], layer.shortest[number])
        fill_set(goals, count, ways, before, found)
        next_set(goals, count, ways.distances.shape[0])


@allocating
def sum_of_lengths(count: int, ways: Any, before: Any, most: int) -> Any:
    """The sums over all sets of `count` goals and all other cells: lengths of the tours with the
    best return, and of the shortest tours, each at most `most`."""
    cells = ways.distances.shape[0]
    goals = np.arange(count)
    long, short = np.empty(cells, dtype=np.int16), np.empty(cells, dtype=np.int16)
    found = Layer(np.empty(cells), long, short)
    taken = np.zeros(cells, dtype=np.bool_)
    total_long, total_short = np.int64(0), np.int64(0)
    going = True
    while going:
        fill_set(goals, count, ways, before, found)
        taken[:] = False
        for goal in goals:
            taken[goal] = True
        for cell in range(cells):
            if not taken[cell]:
                total_long += long[cell] if long[cell] < most else most
                total_short += short[cell] if short[cell] < most else most
        going = next_set(goals, count, cells)
    return total_long, total_short
