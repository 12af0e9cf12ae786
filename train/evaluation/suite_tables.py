"""Tables of policies in each of several mazes, and their exact values by maze.

A runner with one goal is solved as a chaser of an evader that never moves. A policy without memory
is a table over (own cell, other cell); that of a network is computed in batches of mazes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.simulator.policy import DistributionPolicy, Policy, TabularPolicy
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser, NearestGoalRunner, TourRunner, table_of
from train.evaluation.games import steps_and_ended

PAIRS_AT_ONCE = 200_000
"""Maximum number of pairs of cells in one batch of a network."""


def tables_of(policy: Policy, task: Task, seat: int) -> Iterator[NDArray[np.float64]]:
    """[self cell, other cell, action] of a policy in each maze of a task.

    "Other" is the other agent of a duel, or the goal of a single runner.

    Raises:
        ValueError: the policy is no table.
    """
    if hasattr(policy, "task") and isinstance(policy, DistributionPolicy):  # a learned one
        yield from _learned_tables(policy, task, seat)
        return
    if isinstance(policy, (NearestGoalRunner, TourRunner)):  # one goal: a shortest path
        policy = AStarChaser(policy.epsilon)
    if not isinstance(policy, TabularPolicy):
        raise ValueError(f"{policy!r} is not a table over pairs of cells; use sampled evaluation")
    for maze in task.mazes:
        yield table_of(policy, maze, task.stay_action, task.move_order)


def _learned_tables(
    policy: DistributionPolicy, task: Task, seat: int
) -> Iterator[NDArray[np.float64]]:
    some: list[int] = []
    sizes = [maze.num_cells for maze in task.mazes]
    for number in range(len(sizes)):
        some.append(number)
        full = sum(sizes[each] ** 2 for each in some) + max(sizes) ** 2 > PAIRS_AT_ONCE
        if full or number == len(sizes) - 1:
            found = policy.distribution(task, pairs_in(task, some, seat), seat)
            for each in some:
                size = sizes[each]
                yield found[: size * size].reshape(size, size, -1)
                found = found[size * size :]
            some = []


def pairs_in(task: Task, mazes: list[int], seat: int) -> Games:
    """Games in all states (own cell, other cell) of each of these mazes.

    "Other" is the other agent of a duel, or the goal of a single runner.
    """
    sizes = [task.mazes[number].num_cells for number in mazes]
    games = layout.empty_games(sum(size * size for size in sizes), task.num_agents, task.num_goals)
    first = 0
    for number, size in zip(mazes, sizes, strict=True):
        here = slice(first, first + size * size)
        own, other = np.divmod(np.arange(size * size, dtype=np.int32), size)
        games.position[here, seat], games.maze[here] = own, number
        if task.num_goals:
            games.goal[here, 0] = other
        else:
            games.position[here, 1 - seat] = other
        first += size * size
    games.active[:] = 1
    return games


def stays(maze: Maze) -> NDArray[np.float64]:
    """[cells, cells, moves and stay]: the table of a goal, which never moves."""
    table = np.zeros((maze.num_cells, maze.num_cells, maze.num_moves + 1))
    table[..., -1] = 1.0
    return table


def opponent_tables(
    opponent: Policy | None, task: Task, seat: int
) -> Iterator[NDArray[np.float64]]:
    """The table of the opponent of a duel, or of the goal, for each maze."""
    if opponent is None:
        return (stays(maze) for maze in task.mazes)
    return tables_of(opponent, task, 1 - seat)


def pairs_of_values(
    task: Task, seat: int, own: Iterator[NDArray[np.float64]], others: Iterator[NDArray[np.float64]]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Expected steps, and probability of an end within the time limit, for each maze.

    Both are [chaser cell, evader cell], or [runner cell, goal cell] float64.
    """
    for maze, table, other in zip(task.mazes, own, others, strict=True):
        yield steps_and_ended(task, task.seat_roles[seat], (table, other), maze)
