"""A runner that follows a shortest tour through all goals."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules import layout
from pursuit.rules.layout import TABLE, Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.agents import kernels
from scripted_agents.agents.scripted import Scripted
from scripted_agents.exact.limits import why_no_tour
from scripted_agents.exact.tours.kernels import first_of_tour, list_first_moves, plan_next_goals


class Plans(NamedTuple):
    """The cache of a `TourRunner` for each game, int32.

    Attributes:
        next_goal: [games] the cell of the next goal; -1 for none.
        maze, own: [games] the maze and the own cell in the last call.
        goals: [games, goals] the remaining goals in the last call.
    """

    next_goal: NDArray[np.int32]
    maze: NDArray[np.int32]
    own: NDArray[np.int32]
    goals: NDArray[np.int32]

    @classmethod
    def empty(cls, num_games: int, num_goals: int) -> Plans:
        """A cache that matches no state."""
        never = np.full(num_games, -2, dtype=np.int32)
        goals = np.full((num_games, num_goals), -2, dtype=np.int32)
        return cls(never, never.copy(), never.copy(), goals)


class TourRunner(Scripted):
    """Follows a shortest tour through all remaining goals: optimal if it is the only agent.

    For up to `scripted_agents.exact.limits.MAX_EXACT_GOALS` goals. Plans of the last games are
    cached for speed; actions depend only on the state.
    """

    kind, role = kernels.RUNNER, "runner"

    def __init__(self, epsilon: float = 0.0) -> None:
        super().__init__(epsilon)
        self._kept = Plans.empty(0, 0)
        self._kept_for: object = None

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: more than MAX_EXACT_GOALS goals.
        """
        goals = view.task.num_goals
        reason = why_no_tour(goals)
        if reason is not None:
            raise ValueError(f"{self!r}: {reason}")
        if goals == 0:
            return super().act(view)
        if self._kept_for is not view.mazes or self._kept.goals.shape != view.goals.shape:
            self._kept_for, self._kept = view.mazes, Plans.empty(view.num_games, goals)
        if (view.mazes.mazes[TABLE] >= 0).all():
            scratch = (
                np.empty((1 << goals, goals), dtype=np.int32),
                np.empty((1 + goals, 1 + goals), dtype=np.int32),
                np.empty(1 + goals, dtype=np.int64),
            )
            plan_next_goals(view.games, view.seat, view.mazes, self._kept, scratch)
        else:
            self._plan_one_by_one(view)
        # The kernel of the nearest goal gets only one goal, the next of the tour.
        left = np.full_like(view.goals, -1)
        left[:, 0] = self._kept.next_goal
        return super().act(replace(view, games=view.games._replace(goal=left)))

    def moves(self, task: Task, games: Games, seat: int) -> NDArray[np.int64]:
        """As `NearestGoalRunner.moves`, in games of one goal.

        Raises:
            ValueError: several goals. Ties between tours are broken by the indices of goals, so
                actions are no function of the cells of goals.
        """
        if task.num_goals > 1:
            raise ValueError(
                f"{self!r} in task {task.name!r}: with {task.num_goals} goals its actions depend "
                "on the indices of goals, so it has no distribution; use NearestGoalRunner (astar)"
            )
        return super().moves(task, games, seat)

    def _plan_one_by_one(self, view: GameView) -> None:
        """As `plan_next_goals`, for mazes without a distance table."""
        kept = self._kept
        for game, (own, maze) in enumerate(
            zip(view.positions[:, view.seat].tolist(), view.maze_index.tolist(), strict=True)
        ):
            here, goals, aim = view.task.mazes[maze], view.goals[game], int(kept.next_goal[game])
            valid = kept.maze[game] == maze and aim >= 0 and np.array_equal(kept.goals[game], goals)
            if valid and own != kept.own[game]:
                away, before = here.distances_to(aim), kept.own[game]
                valid = own in here.neighbors[before] and away[own] < away[before]
            if not valid:
                kept.next_goal[game] = _next_goal(here, own, goals[goals >= 0].tolist())
                kept.goals[game] = goals
            kept.maze[game], kept.own[game] = maze, own


def _next_goal(maze: Maze, own: int, goals: list[int]) -> int:
    """The goal that a shortest tour visits first, ties by the order in `goals`; -1 for none."""
    if not goals:
        return -1
    cells = np.array([own, *goals])
    between = np.stack([maze.distances_to(int(cell))[cells] for cell in cells])
    best = np.empty((1 << len(goals), len(goals)), dtype=np.int32)
    return int(cells[first_of_tour(between, len(goals), best)])


def first_moves(task: Task, games: Games, seat: int) -> NDArray[np.bool_]:
    """[games, actions] bool, all moves with which a shortest tour through the remaining goals
    begins; none in games without goals.

    Raises:
        ValueError: a maze without a table of distances.
    """
    check_tours(task)
    found = np.zeros((len(games.steps), task.num_actions), dtype=bool)
    own = layout.copied_games(games, slice(None))  # one type: compiled once
    list_first_moves(own, seat, lay_out(task.mazes), found)
    return found


def check_tours(task: Task) -> None:
    """ValueError where `first_moves` does not know the tours of a task."""
    if task.max_cells > MAX_TABLE_CELLS:
        most = f"shortest tours are listed for up to {MAX_TABLE_CELLS}"
        raise ValueError(f"a maze of {task.max_cells} cells; {most}: take a smaller maze")
