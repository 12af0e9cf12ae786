"""Tours that are optimal for the discounted rewards of goals, and their gap to shortest tours.

A runner is trained on a reward for each goal with a discount, and judged by its steps. The policy
that is best by the reward may be longer than the shortest tour: the objective has a floor of its
own, below which no learner that reaches it perfectly can come.
"""

from __future__ import annotations

from math import comb

import numpy as np

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.memory import free_memory
from pursuit.rules import UNREACHABLE
from scripted_agents.tours.objective_kernels import GoalPaths, Layer, one_goal_more, sum_of_lengths

MAX_STEPS_OF_WORK = 3_000_000_000
"""Above this many looks at (set of goals, next goal, cell) it is not enumerated: some seconds."""

MAX_BYTES = 10**9
"""Above this many bytes of tables it is not enumerated."""


def tour_objective_gap(
    maze: Maze,
    num_goals: int,
    discount: float,
    step: float = -0.1,
    goal: float = 1.0,
    max_steps: int | None = None,
) -> float | None:
    """How much longer the tours are that are best by discounted rewards than the shortest, exactly.

    The ratio of the mean lengths, less 1, over all placements of a start and `num_goals` goals in
    cells of their own, by dynamic programming over all sets of goals. Of tours that are equally
    good by the reward the shortest counts, so that no policy that is best by the reward is shorter.
    None where it is not known: too many sets, a maze in parts, or rewards for which hurrying to the
    next goal need not be best (`step` above 0, or `goal` below 0).

    Args:
        maze: where it is played.
        num_goals: of the episode.
        discount: of each step, in (0, 1].
        step, goal: the reward of a step, and of one that collects a goal, in its place.
        max_steps: longer tours count as so many, as in the game; None for no bound.

    Raises:
        ValueError: a discount outside (0, 1], or a number of goals that the maze does not hold.
    """
    cells = maze.num_cells
    if not 0.0 < discount <= 1.0:
        raise ValueError(f"discount {discount}; above 0 and at most 1")
    if not 1 <= num_goals < cells:
        raise ValueError(f"num_goals {num_goals}; {maze.name} holds 1 to {cells - 1}")
    if step > 0.0 or goal < 0.0 or goal <= step or cells > MAX_TABLE_CELLS:
        return None
    work = sum(comb(cells, i) * i * cells for i in range(1, num_goals + 1))
    # Values and both lengths of two layers, the last of which is only summed.
    needed = 12 * cells * sum(comb(cells, i) for i in (num_goals - 1, num_goals - 2) if i >= 0)
    room = min(MAX_BYTES, free_memory())
    if work > MAX_STEPS_OF_WORK or needed > room or (maze.distances == UNREACHABLE).any():
        return None
    distances = maze.distances.astype(np.int16)
    shrinks = discount ** distances.astype(np.float64)
    # What the way to the next goal brings: steps before the last one, and the goal.
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
