"""Shortest paths between two cells, shortest tours from a start through all goals, and their mean
over all placements.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.rules import UNREACHABLE, seed_streams
from pursuit.validation import as_array, whole
from scripted_agents.tours.kernels import (
    draw_placements,
    held_karp,
    held_karp_order,
    sum_of_tours,
    tours_by_table,
)

MAX_EXACT_GOALS = 18
"""More goals than these are refused."""

MAX_ENUMERATED_PLACEMENTS = 2_000_000_000
"""Above this number of placements `expected_tour_length` draws samples."""


@dataclass(frozen=True)
class Tour:
    """A path from the start through all goals, without return.

    Attributes:
        length: its steps.
        order: the distinct goal cells as visited.
    """

    length: int
    order: tuple[int, ...]


class Estimate(float):
    """A mean as a float that knows how sure it is.

    Attributes:
        ci95: half the width of its 95 % confidence interval; 0 when exact.
        exact: whether it is the mean over everything, not over samples.
        samples: how many placements it is the mean of.
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

    A path of k steps has k + 1 cells. By one breadth-first search, which needs no table: memory
    grows linearly with the cells. Which of several shortest paths is found is fixed, but not by a
    rule worth relying on.

    Raises:
        ValueError: a cell is not in the maze, or no path joins the two.
    """
    maze = load_maze(maze)
    start, goal = maze.check_cell(start), maze.check_cell(goal)
    rest = maze.distances_from(goal)
    if rest[start] == UNREACHABLE:
        raise ValueError(
            f"{maze.name}: no path joins the cells {start} and {goal}; choose cells of one part of "
            "the maze, or open a wall between the parts"
        )
    path = [start]
    while path[-1] != goal:
        around = maze.neighbors[path[-1]]
        path.append(int(around[rest[around].argmin()]))
    return path


# -- single tours ----------------------------------------------------------------------------------


def shortest_tour(maze: Maze, start: int, goals: Iterable[int]) -> Tour:
    """The shortest path from `start` through all `goals`, which ends at the last of them.

    A travelling-salesman path on the matrix of path distances: exact by dynamic programming over
    sets of goals (Held and Karp, 1962; Bellman, 1962), some 30 ms and 19 MB for MAX_EXACT_GOALS
    goals. A goal named twice, or on the start, costs nothing. Works for mazes of any size, with one
    breadth-first search a goal.

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
            f"{maze.name}: no path joins the start {start} and the goal {unreachable}; choose "
            "goals of the start's part of the maze, or open a wall between the parts"
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
        maze: the maze that all of them are in.
        starts: [placements] integers, the cell of each start.
        goals: [placements, goals] integers, the cells of the goals; -1 for an absent one.

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
                + ("" if least == 0 else ", and -1 is an absent goal")
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
            f"{maze.name}: placement {wrong}: no path joins the start {start_cells[wrong]} and all "
            f"of the goals {goal_cells[wrong].tolist()}; place them in one part of the maze"
        )
    return lengths


def _check_number(maze: Maze, num_goals: int) -> None:
    if num_goals > MAX_EXACT_GOALS:
        raise ValueError(
            f"{maze.name}: {num_goals} goals; shortest tours are known of up to {MAX_EXACT_GOALS}"
        )


# -- the mean over placements ----------------------------------------------------------------------


def num_placements(num_cells: int, num_goals: int) -> int:
    """The placements of a start and of goals that are distinct, all on different cells."""
    num_cells, num_goals = whole("num_cells", num_cells, 1), whole("num_goals", num_goals, 0)
    return comb(num_cells, num_goals) * (num_cells - num_goals)


def num_states(num_cells: int, num_goals: int) -> int:
    """The distinct states of a runner and up to `num_goals` goals that are left.

    The sum over i = 1 ... num_goals of C(n, i) (n - i): i goals on distinct cells, none of them
    under the runner.
    """
    return sum(num_placements(num_cells, i) for i in range(1, whole("num_goals", num_goals, 0) + 1))


def expected_tour_length(
    maze: Maze, num_goals: int, samples: int = 20_000, seed: int = 0
) -> Estimate:
    """The mean shortest tour over all placements of a start and of `num_goals` goals.

    Start and goals stand on distinct cells, all placements equally likely: what the game draws
    when nothing limits it. Exact by enumeration for 1 to 3 goals while there are at most
    MAX_ENUMERATED_PLACEMENTS and the maze has at most MAX_TABLE_CELLS cells; otherwise the mean
    of `samples` drawn with `seed`, with a 95 % confidence interval (normal approximation).

    A sample costs one tour: microseconds up to 8 goals, milliseconds from 14 on, and in a maze
    beyond MAX_TABLE_CELLS a breadth-first search for each of its cells.

    Raises:
        ValueError: fewer than 1 goal, or more than cells - 1 or MAX_EXACT_GOALS; fewer than 2
            samples, or a maze that falls into parts.
    """
    maze, num_goals = load_maze(maze), whole("num_goals", num_goals, 1)
    samples = whole("samples", samples, 2)
    if num_goals > maze.num_cells - 1:
        raise ValueError(
            f"{maze.name}: num_goals {num_goals}; {maze.num_cells} cells hold a start and 1 to "
            f"{maze.num_cells - 1} goals; choose one of these numbers, or a larger maze"
        )
    if (maze.distances_from(0) == UNREACHABLE).any():
        raise ValueError(
            f"{maze.name}: the maze falls into parts, so some goals are unreachable and the mean "
            "is infinite; open a wall between the parts"
        )
    placements = num_placements(maze.num_cells, num_goals)
    fits = placements <= MAX_ENUMERATED_PLACEMENTS and maze.num_cells <= MAX_TABLE_CELLS
    if num_goals <= 3 and fits:
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
