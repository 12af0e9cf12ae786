"""Shortest paths between cells, shortest tours from a start through all goals, and mean lengths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.rules import UNREACHABLE, seed_streams
from pursuit.validation import as_array, whole
from scripted_agents.exact.limits import MAX_ENUMERATED_PLACEMENTS, why_no_tour
from scripted_agents.exact.tours.kernels import (
    draw_placements,
    held_karp,
    held_karp_order,
    sum_of_tours,
    tours_by_table,
)


@dataclass(frozen=True)
class Tour:
    """A path from the start through all goals, without return to the start.

    Attributes:
        length: number of steps.
        order: the distinct goal cells in the order of visits.
    """

    length: int
    order: tuple[int, ...]


class Estimate(float):
    """A mean as a float, with its confidence interval.

    Attributes:
        ci95: half the width of its 95 % confidence interval; 0 if exact.
        exact: whether it is the mean over all placements, not over samples.
        samples: the number of placements.
    """

    ci95: float
    exact: bool
    samples: int

    def __new__(cls, value: float, ci95: float, exact: bool, samples: int) -> Estimate:
        """A float of this value."""
        estimate = super().__new__(cls, value)
        estimate.ci95, estimate.exact, estimate.samples = ci95, exact, samples
        return estimate

    def __reduce__(self) -> tuple[type[Estimate], tuple[float, float, bool, int]]:
        return type(self), (float(self), self.ci95, self.exact, self.samples)

    def __repr__(self) -> str:
        return f"{float(self)!r}" if self.exact else f"{float(self):.6g} ± {self.ci95:.2g}"


def shortest_path(maze: Maze, start: int, goal: int) -> list[int]:
    """The cells of one shortest path from `start` to `goal`, both included.

    A path of k steps has k + 1 cells. Computed by one breadth-first search, with memory linear in
    the cells. Ties between shortest paths are broken deterministically, by no specified rule.

    Raises:
        ValueError: a cell is not in the maze, or no path connects the two.
    """
    maze = load_maze(maze)
    start, goal = maze.check_cell(start), maze.check_cell(goal)
    rest = maze.distances_to(goal)
    if rest[start] == UNREACHABLE:
        raise ValueError(
            f"{maze.name}: no path connects the cells {start} and {goal}; choose connected cells, "
            "or remove a wall"
        )
    path = [start]
    while path[-1] != goal:
        around = maze.neighbors[path[-1]]
        path.append(int(around[rest[around].argmin()]))
    return path


# -- single tours ----------------------------------------------------------------------------------


def shortest_tour(maze: Maze, start: int, goals: Iterable[int]) -> Tour:
    """The shortest path from `start` through all `goals`, which ends at the last goal.

    A travelling-salesman path on the matrix of path distances: exact by dynamic programming over
    sets of goals (Held and Karp, 1962; Bellman, 1962), about 30 ms and 19 MB for MAX_EXACT_GOALS
    goals. Repeated goals, and goals at the start, add no steps. Works for mazes of any size, with
    one breadth-first search per goal.

    Raises:
        ValueError: a cell is not in the maze, a goal cannot be reached, or there are more than
            MAX_EXACT_GOALS goals.
    """
    maze = load_maze(maze)
    start = maze.check_cell(start)
    if not isinstance(goals, Iterable):
        raise ValueError(f"goals={goals!r}; give the cells of the goals, [] for none")
    cells = np.array([start, *dict.fromkeys(maze.check_cell(goal) for goal in goals)])
    between = np.stack([maze.distances_from(int(cell))[cells] for cell in cells])
    if (between == UNREACHABLE).any():
        unreachable = int(cells[np.argmax(between[0] == UNREACHABLE)])
        raise ValueError(
            f"{maze.name}: no path connects the start {start} and the goal {unreachable}; choose "
            "goals that are reachable from the start, or remove a wall"
        )
    count = len(cells) - 1
    _check_number(maze, count)
    order = np.zeros(count, dtype=np.int64)
    best = np.empty((1 << count, max(count, 1)), dtype=np.int32)
    length = held_karp(between, count, best)
    held_karp_order(between, count, best, order)
    return Tour(int(length), tuple(cells[order].tolist()))


def tour_length(maze: Maze, start: int, goals: Iterable[int]) -> int:
    """The steps of `shortest_tour(maze, start, goals)`; raises what that raises."""
    return shortest_tour(maze, start, goals).length


def tour_lengths(maze: Maze, starts: ArrayLike, goals: ArrayLike) -> NDArray[np.int64]:
    """The shortest tours of many placements at once.

    Args:
        maze: the maze of all placements.
        starts: [placements] integers, the cell of each start.
        goals: [placements, goals] integers, the cells of the goals; -1 for no goal.

    Returns:
        [placements] int64, the length of each tour; 0 without goals.

    Raises:
        ValueError: wrong shapes, a cell that is not in the maze, a goal out of reach, or more than
            MAX_EXACT_GOALS goals.
    """
    maze = load_maze(maze)
    start_cells = as_array("starts", starts, "iu", "cells are integers")
    goal_cells = as_array("goals", goals, "iu", "cells are integers")
    if start_cells.ndim != 1 or goal_cells.ndim != 2 or len(start_cells) != len(goal_cells):
        raise ValueError(
            f"starts has shape {start_cells.shape} and goals {goal_cells.shape}; give [placements] "
            "and [placements, goals]"
        )
    for name, cells, least in (("starts", start_cells, 0), ("goals", goal_cells, -1)):
        if cells.size == 0:
            continue
        if cells.min() < least or cells.max() >= maze.num_cells:
            wrong = cells[(cells < least) | (cells >= maze.num_cells)].flat[0]
            raise ValueError(
                f"{maze.name}: {name} holds {wrong}; the cells are 0 to {maze.num_cells - 1}"
                + ("" if least == 0 else ", and -1 for no goal")
            )
    start_cells, goal_cells = start_cells.astype(np.int64), goal_cells.astype(np.int64)
    if maze.num_cells > MAX_TABLE_CELLS:
        tours = [
            tour_length(maze, start, [goal for goal in row if goal >= 0])
            for start, row in zip(start_cells.tolist(), goal_cells.tolist(), strict=True)
        ]
        return np.array(tours, dtype=np.int64)
    most = int((goal_cells >= 0).sum(axis=1).max(initial=0))
    _check_number(maze, most)
    lengths = np.zeros(len(start_cells), dtype=np.int64)
    tours_by_table(maze.distances, start_cells, goal_cells, most, lengths)
    if (lengths < 0).any():
        wrong = int(np.argmax(lengths < 0))
        raise ValueError(
            f"{maze.name}: placement {wrong}: no path joins start {start_cells[wrong]} and all of "
            f"the goals {goal_cells[wrong].tolist()}; choose connected cells"
        )
    return lengths


def _check_number(maze: Maze, num_goals: int) -> None:
    reason = why_no_tour(num_goals)
    if reason is not None:
        raise ValueError(f"{maze.name}: {reason}")


# -- the mean over placements ----------------------------------------------------------------------


def num_placements(num_cells: int, num_goals: int) -> int:
    """The number of placements of a start and a set of goals in different cells."""
    num_cells, num_goals = whole("num_cells", num_cells, 1), whole("num_goals", num_goals, 0)
    return comb(num_cells, num_goals) * (num_cells - num_goals)


def num_states(num_cells: int, num_goals: int) -> int:
    """The number of states of a runner with 1 to `num_goals` remaining goals.

    The sum over i = 1 ... num_goals of C(n, i) (n - i): i goals in different cells, and the runner
    in another cell.
    """
    return sum(num_placements(num_cells, i) for i in range(1, whole("num_goals", num_goals, 0) + 1))


def expected_tour_length(
    maze: Maze, num_goals: int, samples: int = 20_000, seed: int = 0
) -> Estimate:
    """The mean length of the shortest tour over all placements of a start and `num_goals` goals.

    Start and goals are in different cells, and all placements are equally likely, as in a game with
    random starts. Exact by enumeration for 1 to 3 goals, at most MAX_ENUMERATED_PLACEMENTS
    placements and at most MAX_TABLE_CELLS cells, if no edge is directed. Otherwise the mean of
    `samples` drawn with `seed`, with a 95 % confidence interval (normal approximation).

    A sample takes one tour: microseconds up to 8 goals, milliseconds from 14 on. In mazes with more
    than MAX_TABLE_CELLS cells it takes a breadth-first search for each start and goal.

    Raises:
        ValueError: fewer than 1 goal, or more than cells - 1 or MAX_EXACT_GOALS; fewer than 2
            samples, or a maze that is not connected.
    """
    maze, num_goals = load_maze(maze), whole("num_goals", num_goals, 1)
    samples = whole("samples", samples, 2)
    if num_goals > maze.num_cells - 1:
        raise ValueError(
            f"{maze.name}: num_goals={num_goals}; {maze.num_cells} cells hold a start and 1 to "
            f"{maze.num_cells - 1} goals; give fewer goals or a larger maze"
        )
    if (maze.distances_from(0) == UNREACHABLE).any():
        raise ValueError(
            f"{maze.name}: the maze is not connected, so some goals are unreachable and the mean "
            "is infinite; remove a wall between its parts"
        )
    placements = num_placements(maze.num_cells, num_goals)
    fits = placements <= MAX_ENUMERATED_PLACEMENTS and maze.num_cells <= MAX_TABLE_CELLS
    if num_goals <= 3 and fits and not maze.is_directed:
        total = int(sum_of_tours(maze.distances, num_goals))
        return Estimate(total / placements, ci95=0.0, exact=True, samples=placements)
    _check_number(maze, num_goals)
    drawn = np.empty((samples, num_goals + 1), dtype=np.int64)
    streams = np.empty((1, 1), dtype=np.uint64)
    seed_streams(streams, whole("seed", seed, 0, 2**63 - 1), 0)
    draw_placements(maze.num_cells, streams[0], drawn)
    lengths = tour_lengths(maze, drawn[:, 0], drawn[:, 1:])
    half_width = 1.96 * float(lengths.std(ddof=1)) / samples**0.5
    return Estimate(float(lengths.mean()), ci95=half_width, exact=False, samples=samples)
