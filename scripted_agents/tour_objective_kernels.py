"""Compiled kernels of `objective`: best tours by discounted rewards, over all sets of goals.

Sets of goals are numbered in the combinatorial number system: the set c1 < c2 < ... has the number
C(c1, 1) + C(c2, 2) + ... A *layer* has for every set of one size and every cell outside of it the
value of the best tour from that cell, the length of that tour, and that of the shortest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import allocating, compiled

TIE = 1e-12
"""Relative difference below which two tours count as equally good."""


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
def look_at(
    goals: Any,
    count: int,
    distances: Any,
    ways: Any,
    shrinks: Any,
    binomials: Any,
    values: Any,
    best: Any,
    shortest: Any,
    value: Any,
    long: Any,
    short: Any,
) -> None:
    """Fill value, long and short [cells] for one set of `count` goals from the layer before."""
    cells = distances.shape[0]
    value[:] = -np.inf
    long[:] = 0
    short[:] = 32767
    for i in range(count):
        goal = goals[i]
        rest = number_without(goals, count, i, binomials)
        after, then, least = values[rest, goal], best[rest, goal], shortest[rest, goal]
        for cell in range(cells):
            way = distances[goal, cell]
            gain = ways[goal, cell] + shrinks[goal, cell] * after
            length = way + then
            margin = TIE * (1.0 + abs(gain))
            better = gain > value[cell] + margin
            as_good = gain >= value[cell] - margin
            if better or (as_good and length < long[cell]):
                long[cell] = length
            value[cell] = gain if gain > value[cell] else value[cell]
            short[cell] = min(short[cell], way + least)


@allocating
def one_goal_more(
    count: int,
    distances: Any,
    ways: Any,
    shrinks: Any,
    binomials: Any,
    values: Any,
    best: Any,
    shortest: Any,
    new_values: Any,
    new_best: Any,
    new_shortest: Any,
) -> None:
    """Fill the layer of sets of `count` goals from that of one goal less.

    Args:
        count: goals of a set.
        distances: [cells, cells] int16, steps.
        ways: [cells, cells] float64, the discounted reward of the way to a goal.
        shrinks: [cells, cells] float64, the discount of that way.
        binomials: [cells + 1, goals + 1] int64.
        values, best, shortest: [sets, cells], the layer before.
        new_values, new_best, new_shortest: [sets, cells], written.
    """
    cells = distances.shape[0]
    goals = np.arange(count)
    for number in range(new_values.shape[0]):
        look_at(
            goals, count, distances, ways, shrinks, binomials, values, best, shortest,
            new_values[number], new_best[number], new_shortest[number],
        )  # fmt: skip
        next_set(goals, count, cells)


@allocating
def sum_of_lengths(
    count: int,
    distances: Any,
    ways: Any,
    shrinks: Any,
    binomials: Any,
    values: Any,
    best: Any,
    shortest: Any,
    most: int,
) -> Any:
    """The sums, over all sets of `count` goals and all other cells, of the lengths of the tours
    that are best by reward and of the shortest, each at most `most`; arrays as above."""
    cells = distances.shape[0]
    goals = np.arange(count)
    value = np.empty(cells)
    long, short = np.empty(cells, dtype=np.int16), np.empty(cells, dtype=np.int16)
    taken = np.zeros(cells, dtype=np.bool_)
    total_long, total_short = np.int64(0), np.int64(0)
    going = True
    while going:
        look_at(
            goals, count, distances, ways, shrinks, binomials, values, best, shortest,
            value, long, short,
        )  # fmt: skip
        taken[:] = False
        for goal in goals:
            taken[goal] = True
        for cell in range(cells):
            if not taken[cell]:
                total_long += long[cell] if long[cell] < most else most
                total_short += short[cell] if short[cell] < most else most
        going = next_set(goals, count, cells)
    return total_long, total_short
