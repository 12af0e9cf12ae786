"""The chase with a limited view: a proven interval of the optimum, and a policy that attains it.

A duel in which the opponent plays a table and has a full view, while the responder sees the
opponent only in cells that are visible from its own cell.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.simulator.policy import GameView
from pursuit.validation import shortened
from scripted_agents.agents.table_policy import checked_table
from scripted_agents.exact.duel.best_response import MoveOrder
from scripted_agents.exact.hidden.beliefs import BeliefAgent, BeliefFilter
from scripted_agents.exact.hidden.game import Role, VisibilityRules, hidden_chase
from scripted_agents.exact.hidden.kernels import choose_actions
from scripted_agents.exact.hidden.layout import workspace_for
from scripted_agents.exact.hidden.search import DEFAULT_MEMORY, HiddenSearch, OnProgress


@dataclass(frozen=True, eq=False)
class HiddenChaseSolution:
    """The result of `solve_hidden_chase`; `improve` continues the search.

    All values are expected discounted steps until capture: the step t = 0, 1, ... counts
    discount**t, including the step of the capture.

    Attributes:
        maze, rules: the game; `rules.view_radius` and so on.
        opponent_table: [self cell, other cell, action] float64, the opponent.
        search: the bounds, as costs of the responder, which are negative for an evader.
    """

    maze: Maze
    rules: VisibilityRules
    opponent_table: NDArray[np.float64] = field(repr=False)
    search: HiddenSearch = field(repr=False)

    @property
    def role(self) -> Role:
        """The role of the responder."""
        return self.rules.role

    @property
    def discount(self) -> float:
        """The discount of each step."""
        return self.rules.discount

    @property
    def lower(self) -> float:
        """A proven lower bound of the optimum, averaged over starts; an evader attains it."""
        return self.search.lower if self.role == "chaser" else -self.search.upper

    @property
    def upper(self) -> float:
        """A proven upper bound of the optimum, averaged over starts; a chaser attains it."""
        return self.search.upper if self.role == "chaser" else -self.search.lower

    @property
    def width(self) -> float:
        """upper / lower - 1, the relative width of the interval."""
        return self.search.width

    @property
    def seconds(self) -> float:
        """The time of the search so far."""
        return self.search.seconds

    def bounds(self, own_cell: int, belief: ArrayLike) -> tuple[float, float]:
        """Proven bounds of the optimum from a belief.

        Args:
            own_cell: the responder's cell.
            belief: [cells], probabilities of the opponent's cell; in the own cell it counts as
                captured.

        Raises:
            ValueError: an invalid cell, or no distribution.
        """
        low, up = self.search.bounds(own_cell, belief)
        return (low, up) if self.role == "chaser" else (-up, -low)

    @cached_property
    def policy(self) -> BeliefOptimal:
        """A policy that attains the bound: a chaser at most `upper`, an evader at least `lower`.

        It uses the plans at the time of the first access.
        """
        return (BeliefOptimalChaser if self.role == "chaser" else BeliefOptimalEvader)(self)

    def improve(
        self, seconds: float, width: float | None = None, report: OnProgress | None = None
    ) -> None:
        """Continue the search, arguments as in `solve_hidden_chase`; `policy` is updated."""
        self.__dict__.pop("policy", None)
        self.search.improve(seconds, width, report)


def solve_hidden_chase(
    maze: Maze | str,
    opponent_table: ArrayLike,
    view_radius: int | None = 2,
    line_of_sight: bool = False,
    discount: float = 0.95,
    seconds: float = 60.0,
    width: float | None = None,
    role: Role = "chaser",
    stay_action: bool | None = None,
    move_order: MoveOrder = "simultaneous",
    min_start_distance: int = 1,
    memory: int = DEFAULT_MEMORY,
    report: OnProgress | None = None,
) -> HiddenChaseSolution:
    """Prove an interval of the optimum of an agent with a limited view against a tabular opponent.

    The responder knows the maze and the opponent's table, and sees the opponent if it is in view
    after the moves of a step or at the start. The opponent has a full view. A chaser minimises the
    expected discounted steps until capture, an evader maximises them. At the start an opponent out
    of view is equally likely in all cells out of view. The game ends only with the capture. The
    bounds are those of a `HiddenSearch`.

    Args:
        maze: the maze, or its name.
        opponent_table: [self cell, other cell, action], the opponent's probabilities.
        view_radius: path distance up to which cells are visible; None for no limit.
        line_of_sight: whether cells are visible only along rows and columns, up to the next wall;
            applies in addition to a radius.
        discount: of each step, above 0 and below 1.
        seconds: time limit of the search, on one core; it ends earlier at the limits of precision.
        width: upper / lower - 1 at which the search ends.
        role: of the responder, "chaser" or "evader".
        stay_action: whether the responder has the stay action; by default as the opponent.
        move_order: as in `Task`.
        min_start_distance: least path distance at the start, as in `Task`.
        memory: maximum bytes of the bounds; if they are full, the least useful parts are dropped.
        report: called regularly with the seconds and both bounds of the responder's costs.

    Raises:
        ValueError: an invalid argument, or a table of a wrong shape or with a row that is no
            distribution.
    """
    maze = load_maze(maze)
    if maze.num_cells > MAX_TABLE_CELLS:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells; give a maze of at most {MAX_TABLE_CELLS}"
        )
    table = checked_table(maze, opponent_table, "opponent_table")
    stays = table.shape[2] > maze.num_moves if stay_action is None else stay_action
    rest = discount, move_order, stays, min_start_distance
    rules = VisibilityRules(role, view_radius, line_of_sight, *rest)
    search = HiddenSearch(hidden_chase(maze, table, rules), memory)
    search.improve(seconds, width, report)
    return HiddenChaseSolution(maze, rules, table, search)


# -- the policy ------------------------------------------------------------------------------------


class OpponentTable:
    """A policy with the same table in any task."""

    def __init__(self, table: NDArray[np.float64]) -> None:
        self.table = table

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64."""
        return self.table


class BeliefOptimal(BeliefAgent):
    """Plays the plans that a `HiddenChaseSolution` has at construction; a `MemoryPolicy`.

    In each game it computes the exact distribution of the opponent's cell given all observations
    (`BeliefFilter`), and takes the action with the least cost by a one-step lookahead to the plans.
    Against the opponent and from the starts of the solution, its expectation is at least as good as
    the bound: `upper` for a chaser, `lower` for an evader. It uses the view limits of the solution,
    even if those of the task are wider.

    Args:
        solution: of `solve_hidden_chase`.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
    """

    def __init__(self, solution: HiddenChaseSolution, epsilon: float = 0.0) -> None:
        if not isinstance(solution, HiddenChaseSolution):
            raise ValueError(f"solution={shortened(solution)}; give one of solve_hidden_chase")
        rules, search = solution.rules, solution.search
        if rules.role != self.role:
            raise ValueError(
                f"{type(self).__name__} plays the {self.role}, and the solution is for the "
                f"{rules.role}; use its .policy"
            )
        opponent = OpponentTable(solution.opponent_table)
        super().__init__(BeliefFilter(opponent, rules.view_radius, rules.line_of_sight), epsilon)
        self.maze, self._rules, self._visible = solution.maze, rules, search.game.visible
        self._model, self._plans = search.model, search.plans()
        self._workspace = workspace_for(self._model, 0, self._plans.action.shape[1], 0)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._rules}, epsilon={self.epsilon:g})"

    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        moves, own = np.empty(view.num_games, dtype=np.uint8), view.positions[:, view.seat]
        choose_actions(
            self._model, self._plans, self._workspace, np.ascontiguousarray(own), belief, moves
        )
        return moves

    def _check(self, view: GameView) -> None:
        super()._check(view)
        task, rules = view.task, self._rules
        if not task.is_duel or task.mazes != (self.maze,):
            raise ValueError(
                f"{self!r} is for a duel in {self.maze.name}; task {task.name!r} is another game"
            )
        if (self._visible & ~task.sees(view.seat)).any():
            raise ValueError(
                f"{self!r} has a wider view than its agent in task {task.name!r}; solve the game "
                "with the view limits of the task"
            )
        if (task.move_order, task.stay_action) != (rules.move_order, rules.stay_action):
            raise ValueError(
                f"{self!r} is solved for move_order={rules.move_order!r} and "
                f"stay_action={rules.stay_action}; task {task.name!r} has "
                f"{task.move_order!r} and {task.stay_action}"
            )


class BeliefOptimalChaser(BeliefOptimal):
    """The chaser of a `HiddenChaseSolution`."""

    role = "chaser"


class BeliefOptimalEvader(BeliefOptimal):
    """The evader of a `HiddenChaseSolution`."""

    role = "evader"
