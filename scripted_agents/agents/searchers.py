"""Agents of limited sight: they act on what is in view, and on what they remember of it.

They know the walls of the maze. With everything in view they play as the A* agents do, action for
action.
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
    """The common ground of agents that see a part of the games only, and remember.

    Args:
        epsilon: share of random moves in [0, 1]; the simulator's own epsilon of a game goes first.
        view_radius: path steps that it sees; what the task lets its seat see where left out.
        line_of_sight: whether it sees along rows and columns only, until a wall; with a radius as
            well both must hold.

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
        self.memory = Memory(_remembered)
        self._moves = Memory(self._moves_of)

    def __repr__(self) -> str:
        settings = [f"epsilon={self.epsilon:g}", repr(self.view_tables)]
        return f"{type(self).__name__}({', '.join(filter(None, settings))})"

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games of `view` (numbers [n] in it): their episodes begin now."""
        for array in self.memory.of(view).values():
            array[view.rows[games]] = -1

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: another role's seat, or a maze too large for tables of pairs of cells.
        """
        check_plays(self, view.task, view.seat)
        masks = np.zeros(view.num_games, dtype=np.uint8)
        kept = search_kernels.Remembered(**self.memory.of(view))
        search_kernels.list_moves_by_sight(
            ROLES.index(self.role),
            view.games,
            view.seat,
            tuple(view.task.teams),
            view.mazes,
            self.view_tables.table(view),
            self._moves.of(view)["moves"],
            view.rows,
            *kept,
            int(self.remembered),
            masks,
        )
        return draw_actions(view, masks, self.epsilon)

    def _moves_of(self, view: GameView) -> dict[str, NDArray[Any]]:
        """The moves towards (of an evader away from) each cell."""
        kind = kernels.EVADER if self.role == "evader" else kernels.CHASER
        settings = (0.0, self.alert_distance, self.look_radius, view.task.stay_action)
        return {"moves": greedy_moves(kind, view.mazes, settings)}


class SearchingChaser(LimitedAgent):
    """Chases visible evaders, else goes to where it last saw one, else sweeps the maze.

    In view it heads for the nearest evader, as `AStarChaser`; out of view for the cell in which one
    was in view last. From there it sweeps: to the nearest of the cells that have been out of view
    for longest, those never seen first. Ties are drawn uniformly.
    """

    role, remembered = "chaser", True


class SweepingChaser(SearchingChaser):
    """Chases visible evaders, else sweeps the maze; it does not remember evaders out of view."""

    remembered = False


class SearchingRunner(LimitedAgent):
    """Collects the nearest goal of those it has seen, and sweeps while it knows of none.

    A goal that another has taken is forgotten when its cell is in view.
    """

    role = "runner"


class WaryEvader(LimitedAgent):
    """Flees from the nearest chaser in view, as `AStarEvader` does, or from where it was last seen.

    A chaser out of view is forgotten after `remembered` steps, and when that cell is in view and
    nobody is there. Without one it moves uniformly.

    Args:
        epsilon: share of random moves in [0, 1]; the simulator's own epsilon of a game goes first.
        view_radius: path steps that it sees; what the task lets its seat see where left out.
        line_of_sight: whether it sees along rows and columns only, until a wall.
        alert_distance: path distance below which a chaser is a threat.
        look_radius: path distance of the farthest cell that it considers.
        remembered: steps for which it flees from a chaser out of view.

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


def _remembered(view: GameView) -> dict[str, NDArray[Any]]:
    """What all of them may keep of a batch, as `search_kernels.Remembered` names it."""
    games, task = view.num_games, view.task
    shapes = ((games, task.max_cells), (games, task.num_goals), (games,), (games,))
    return {
        name: np.full(shape, -1, dtype=np.int32)
        for name, shape in zip(search_kernels.Remembered._fields, shapes, strict=True)
    }
