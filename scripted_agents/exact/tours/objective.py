"""Tours that maximise discounted rewards of goals, and their gap to shortest tours.

A runner is trained with a discounted reward for each goal and evaluated by its steps. The policy
with the best return may take more steps than the shortest tour. This objective gap remains even if
a learner is optimal.
"""

from __future__ import annotations

from math import comb

import numpy as np

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.memory import free_memory
from pursuit.rules import UNREACHABLE
from scripted_agents.exact.limits import MAX_TOUR_BYTES, MAX_TOUR_WORK
from scripted_agents.exact.tours.objective_kernels import (
    GoalPaths,
    Layer,
    one_goal_more,
    sum_of_lengths,
)


def tour_objective_gap(
    maze: Maze,
    num_goals: int,
    discount: float,
    step: float = -0.1,
    goal: float = 1.0,
    max_steps: int | None = None,
) -> float | None:
    """The exact gap of the tours with the best discounted return to the shortest tours.

    The ratio of the mean lengths minus 1, over all placements of a start and `num_goals` goals in
    different cells, by dynamic programming over all sets of goals. Ties between returns are broken
    by length, so no policy with the best return is shorter. None if unknown: too many sets, a maze
    that is not connected, or rewards for which shortest paths between goals need not be optimal
    (`step` above 0, or `goal` below 0).

    Args:
        maze: the maze.
        num_goals: of the episode.
        discount: of each step, in (0, 1].
        step, goal: the rewards of a step and of a step that collects a goal.
        max_steps: time limit, at which longer tours are truncated; None for none.

    Raises:
        ValueError: a discount outside (0, 1], or more goals than the maze can hold.
    """
    cells = maze.num_cells
    if not 0.0 < discount <= 1.0:
        raise ValueError(f"discount={discount}; give a number above 0 and at most 1")
    if not 1 <= num_goals < cells:
        raise ValueError(f"num_goals={num_goals}; give 1 to {cells - 1} for maze {maze.name}")
    if step > 0.0 or goal < 0.0 or goal <= step or cells > MAX_TABLE_CELLS:
        return None
    work = sum(comb(cells, i) * i * cells for i in range(1, num_goals + 1))
    # Values and both lengths of two layers; the last layer is only summed.
    needed = 12 * cells * sum(comb(cells, i) for i in (num_goals - 1, num_goals - 2) if i >= 0)
    free = min(MAX_TOUR_BYTES, free_memory())
    if work > MAX_TOUR_WORK or needed > free or (maze.distances == UNREACHABLE).any():
        return None
    distances = np.ascontiguousarray(maze.distances.T, dtype=np.int16)
    shrinks = discount ** distances.astype(np.float64)
    # The discounted reward of a path to the next goal: steps before the last one, and the goal.
    before = np.maximum(distances - 1, 0)
    if discount < 1.0:
        rewards = step * (1.0 - discount**before) / (1.0 - discount) + goal * discount**before
    else:
        rewards = step * before + goal
    binomials = np.array(
        [[comb(n, k) for k in range(num_goals + 1)] for n in range(cells + 1)], dtype=np.int64
    )
    ways = GoalPaths(distances, rewards, shrinks, binomials)
    layer = _layer(1, cells)
    for count in range(1, num_goals):
        smaller, layer = layer, _layer(comb(cells, count), cells)
        one_goal_more(count, ways, smaller, layer)
    most = max_steps if max_steps is not None else np.iinfo(np.int64).max
    long, short = sum_of_lengths(num_goals, ways, layer, most)
    return float(long / short - 1.0)


def _layer(sets: int, cells: int) -> Layer:
    shape = sets, cells
    lengths, shortest = np.zeros((2, *shape), dtype=np.int16)
    return Layer(np.zeros(shape), lengths, shortest)
