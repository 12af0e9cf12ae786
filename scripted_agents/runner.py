"""Runners: to the nearest goal, or along the shortest tour through all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import GameView
from scripted_agents import kernels
from scripted_agents.scripted import Scripted
from scripted_agents.tour import MAX_EXACT_GOALS, shortest_tour
from scripted_agents.tour_kernels import plan_next_goals


class NearestGoalRunner(Scripted):
    """With probability epsilon a random move, else a first step towards the nearest goal.

    Goals that are equally near, and paths that are equally short, are drawn uniformly. An evader
    that collects goals can be played by it as well; it ignores chasers.
    """

    kind = kernels.RUNNER


class TourRunner(Scripted):
    """Optimal where it is alone: follows a shortest tour through all goals that are left.

    Exact up to `scripted_agents.tour.MAX_EXACT_GOALS` goals, a heuristic tour beyond. It keeps the
    plans of the games that it last saw, for speed only.
    """

    kind = kernels.RUNNER

    def __init__(self, epsilon: float = 0.0) -> None:
        super().__init__(epsilon)
        self._kept = np.zeros((0, 0), dtype=np.int32)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream."""
        goals, first = view.task.num_goals, 3 * view.task.num_agents
        if goals == 0:
            return super().act(view)
        if self._kept.shape != (view.num_games, 3 + goals):
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
            moved = kept[1] != maze or own not in place.neighbors[kept[2]]
            if moved or not np.array_equal(kept[3:], goals):
                tour = shortest_tour(place, int(own), goals[goals >= 0].tolist())
                kept[0] = tour.order[0] if tour.order else -1
                kept[3:] = goals
            kept[1], kept[2] = maze, own
