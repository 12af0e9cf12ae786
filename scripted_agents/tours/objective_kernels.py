"""Compiled kernels of `objective`: best tours by discounted rewards, over all sets of goals.

Sets of goals are numbered in the combinatorial number system: the set c1 < c2 < ... has the number
C(c1, 1) + C(c2, 2) + ...
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import allocating, compiled

TIE = 1e-12
"""Relative difference below which two tours count as equally good."""


class GoalPaths(NamedTuple):
    """The ways from every cell to every goal.

    Attributes:
        distances: [goal, cell] int16, steps.
        rewards: [goal, cell] float64, the discounted reward of the way.
        shrinks: [goal, cell] float64, the discount of what comes after it.
        binomials: [cells + 1, goals + 1] int64.
    """

    distances: Any
    rewards: Any
    shrinks: Any
    binomials: Any


class Layer(NamedTuple):
    """What is known of all sets of goals of one size, from every cell outside of them.

    Attributes:
        values: [sets, cells] float64, of the best tour by reward.
        lengths: [sets, cells] int16, of that tour.
        shortest: [sets, cells] int16, of the shortest tour.
    """

    values: Any
    lengths: Any
    shortest: Any


@compiled
def next_set(goals: Any, count: int, cells: int) -> Any:
    """Move on to the next set in the order of their numbers; whether there is one."""
    i = 0
    while i < count - 1 and goals[i] + 1 == goals[i + 1]:
        goals[i] = i
        i += 1
    goals[i] += 1
    return goals[count - 1] < cells


@compiled
def number_without(goals: Any, count: int, gone: int, binomials: Any) -> Any:
    """The number of the set without its member at `gone`."""
    number = np.int64(0)
    for i in range(count):
        if i != gone:
            number += binomials[goals[i], i + 1 if i < gone else i]
    return number


@compiled
def look_at(goals: Any, count: int, ways: Any, before: Any, found: Any) -> None:
    """Fill `found`, the rows [cells] of one set of `count` goals, from the layer before."""
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
    """Fill the layer of sets of `count` goals from that of one goal less."""
    goals = np.arange(count)
    for number in range(layer.values.shape[0]):
        found = Layer(layer.values[number], layer.lengths[number], layer.shortest[number])
        look_at(goals, count, ways, before, found)
        next_set(goals, count, ways.distances.shape[0])


@allocating
def sum_of_lengths(count: int, ways: Any, before: Any, most: int) -> Any:
    """The sums, over all sets of `count` goals and all other cells, of the lengths of the tours
    that are best by reward and of the shortest, each at most `most`."""
    cells = ways.distances.shape[0]
    goals = np.arange(count)
    long, short = np.empty(cells, dtype=np.int16), np.empty(cells, dtype=np.int16)
    found = Layer(np.empty(cells), long, short)
    taken = np.zeros(cells, dtype=np.bool_)
    total_long, total_short = np.int64(0), np.int64(0)
    going = True
    while going:
        look_at(goals, count, ways, before, found)
        taken[:] = False
        for goal in goals:
            taken[goal] = True
        for cell in range(cells):
            if not taken[cell]:
                total_long += long[cell] if long[cell] < most else most
                total_short += short[cell] if short[cell] < most else most
        going = next_set(goals, count, cells)
    return total_long, total_short
