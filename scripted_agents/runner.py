"""Runners: to the nearest goal, or along the shortest tour through all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze
from pursuit.policy import GameView
from scripted_agents import kernels
from scripted_agents.scripted import Scripted
from scripted_agents.tour import MAX_EXACT_GOALS, shortest_tour
from scripted_agents.tour_kernels import first_of_tour, plan_next_goals


class NearestGoalRunner(Scripted):
    """With probability epsilon a random move, else a first step towards the nearest goal.

    Goals that are equally near, and paths that are equally short, are drawn uniformly. An evader
    that collects goals can be played by it as well; it ignores chasers.
    """

    kind, role = kernels.RUNNER, "runner"


class TourRunner(Scripted):
    """Optimal where it is alone: follows a shortest tour through all goals that are left.

    Exact up to `scripted_agents.tour.MAX_EXACT_GOALS` goals, a heuristic tour beyond. It keeps the
    plans of the games that it last saw, for speed only: what it does depends on the state alone.
    """

    kind, role = kernels.RUNNER, "runner"

    def __init__(self, epsilon: float = 0.0) -> None:
        super().__init__(epsilon)
        self._kept = np.zeros((0, 0), dtype=np.int32)
        self._kept_for: object = None

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream."""
        goals, first = view.task.num_goals, 3 * view.task.num_agents
        if goals == 0:
            return super().act(view)
        if self._kept_for is not view.cells or self._kept.shape != (view.num_games, 3 + goals):
            self._kept_for = view.cells
            self._kept = np.full((view.num_games, 3 + goals), -2, dtype=np.int32)
        if len(view.tables) and goals <= MAX_EXACT_GOALS and (view.mazes[:, 2] >= 0).all():
            plan_next_goals(view.rows, view.seat, first, goals, view.mazes, view.tables, self._kept)
        else:
            self._plan_one_by_one(view)
        # The kernel of the nearest goal sees one goal only: the next of the tour.
        rows = view.rows.copy()
        rows[:, first : first + goals] = -1
        rows[:, first] = self._kept[:, 0]
        return super().act(replace(view, rows=rows))

    def _plan_one_by_one(self, view: GameView) -> None:
        """The same where mazes have no distance table, or goals are too many to be exact."""
        for kept, own, maze, goals in zip(
            self._kept, view.positions[:, view.seat], view.maze_index, view.goals, strict=True
        ):
            place = view.task.mazes[maze]
            holds = kept[1] == maze and kept[0] >= 0 and np.array_equal(kept[3:], goals)
            if holds and own != kept[2]:
                away = place.distances_from(int(kept[0]))
                holds = own in place.neighbors[kept[2]] and away[own] < away[kept[2]]
            if not holds:
                kept[0] = _next_goal(place, int(own), goals[goals >= 0].tolist())
                kept[3:] = goals
            kept[1], kept[2] = maze, own


def _next_goal(maze: Maze, own: int, goals: list[int]) -> int:
    """The goal that a shortest tour visits first, of several the first in `goals`; -1 for none."""
    if not goals:
        return -1
    if len(goals) > MAX_EXACT_GOALS:
        return shortest_tour(maze, own, goals).order[0]
    cells = np.array([own, *goals])
    between = np.stack([maze.distances_from(int(cell))[cells] for cell in cells])
    best = np.empty((1 << len(goals), len(goals)), dtype=np.int32)
    return int(cells[first_of_tour(between, len(goals), best)])
