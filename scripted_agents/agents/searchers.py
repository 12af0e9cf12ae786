"""Scripted agents with a limited view, which act on visible agents and goals and on a memory.

They know the walls of the maze. With a full view their actions are those of the A* agents.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import GameView, Memory, check_plays
from pursuit.tasks.task import ROLES
from pursuit.validation import check_probability, whole
from scripted_agents.agents import kernels, search_kernels
from scripted_agents.agents.scripted import draw_actions, greedy_moves
from scripted_agents.agents.view_tables import ViewTables


class LimitedAgent:
    """The base class of agents with a limited view and a memory.

    Args:
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        view_radius: path distance up to which cells are visible; by default the limits of the task.
        line_of_sight: whether cells are visible only along rows and columns, up to the next wall;
            applies in addition to a radius.

    Raises:
        ValueError: a setting outside these limits.
    """

    role = ""
    remembered: int = 0
    alert_distance = look_radius = 0

    def __init__(
        self, epsilon: float = 0.0, view_radius: int | None = None, line_of_sight: bool = False
    ) -> None:
        self.epsilon = check_probability("epsilon", epsilon)
        self.view_tables = ViewTables(view_radius, line_of_sight)
        self.memory = Memory(_empty_memory)
        self._moves = Memory(self._moves_of)

    def __repr__(self) -> str:
        settings = [f"epsilon={self.epsilon:g}", repr(self.view_tables)]
        return f"{type(self).__name__}({', '.join(filter(None, settings))})"

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Clear the memory of `games` [n] (indices in `view`), in which new episodes start."""
        for array in self.memory.of(view).values():
            array[view.rows[games]] = -1

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: an agent of another role, or a maze too large for tables of pairs of cells.
        """
        check_plays(self, view.task, view.seat)
        masks = np.zeros(view.num_games, dtype=np.uint8)
        kept = search_kernels.SearchMemory(**self.memory.of(view))
        visible, moves = self.view_tables.table(view), self._moves.of(view)["moves"]
        search_kernels.list_moves_in_view(
            ROLES.index(self.role), view.games, view.seat, tuple(view.task.teams), view.mazes,
            visible, moves, view.rows, kept, int(self.remembered), masks,
        )  # fmt: skip
        return draw_actions(view, masks, self.epsilon)

    def _moves_of(self, view: GameView) -> dict[str, NDArray[Any]]:
        """The moves towards each cell, or away from it for an evader."""
        kind = kernels.EVADER if self.role == "evader" else kernels.CHASER
        settings = (0.0, self.alert_distance, self.look_radius, view.task.stay_action)
        return {"moves": greedy_moves(kind, view.mazes, settings)}


class SearchingChaser(LimitedAgent):
    """Chases visible evaders, else goes to where it last saw one, else sweeps the maze.

    It goes to the nearest visible evader, as `AStarChaser`, else to the cell in which one was last
    visible. From there it sweeps: it goes to the nearest of the cells that have been out of view
    for longest, or were never seen. Ties are broken uniformly.
    """

    role, remembered = "chaser", True


class SweepingChaser(SearchingChaser):
    """Chases visible evaders, else sweeps the maze, without a memory of evaders."""

    remembered = False


class SearchingRunner(LimitedAgent):
    """Goes to the nearest goal that it has seen, and sweeps the maze if there is none.

    A goal collected by another agent is dropped when its cell is visible.
    """

    role = "runner"


class WaryEvader(LimitedAgent):
    """Flees from the nearest chaser in view, as `AStarEvader` does, or from where it was last seen.

    That cell is dropped after `remembered` steps, and when it is visible without a chaser. Without
    a chaser or such a cell the evader moves uniformly.

    Args:
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        view_radius: path distance up to which cells are visible; by default the limits of the task.
        line_of_sight: whether cells are visible only along rows and columns, up to the next wall.
        alert_distance: path distance below which a chaser is a threat.
        look_radius: path distance of the farthest cells that it considers.
        remembered: number of steps for which it flees from a chaser that is out of view.

    Raises:
        ValueError: a setting outside these limits.
    """

    role = "evader"

    def __init__(
        self,
        epsilon: float = 0.0,
        view_radius: int | None = None,
        line_of_sight: bool = False,
        alert_distance: int = 3,
        look_radius: int = 3,
        remembered: int = 5,
    ) -> None:
        super().__init__(epsilon, view_radius, line_of_sight)
        self.alert_distance = whole("alert_distance", alert_distance, 0)
        self.look_radius = whole("look_radius", look_radius, 1)
        self.remembered = whole("remembered", remembered, 0)


def _empty_memory(view: GameView) -> dict[str, NDArray[Any]]:
    """The fields of `search_kernels.SearchMemory` for a batch, without content."""
    games, task = view.num_games, view.task
    shapes = ((games, task.max_cells), (games, task.num_goals), (games,), (games,))
    return {
        name: np.full(shape, -1, dtype=np.int32)
        for name, shape in zip(search_kernels.SearchMemory._fields, shapes, strict=True)
    }
