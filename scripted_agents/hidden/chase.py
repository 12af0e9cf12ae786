"""The chase with a limited view: a proven interval of the optimum, and a policy that attains it.

The chase of one against one, in which the opponent plays a table and sees everything, while the
responder sees the opponent only in cells that are visible from its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.simulator.policy import GameView
from scripted_agents.duel.best_response import MoveOrder, checked_table
from scripted_agents.hidden.beliefs import BeliefAgent, BeliefFilter
from scripted_agents.hidden.game import Role, VisibilityRules, hidden_chase
from scripted_agents.hidden.kernels import choose_actions
from scripted_agents.hidden.layout import workspace_for
from scripted_agents.hidden.search import DEFAULT_MEMORY, HiddenSearch, Report


@dataclass(frozen=True, eq=False)
class HiddenChaseSolution:
    """What `solve_hidden_chase` has found so far; `improve` goes on.

    All values are expected discounted steps until capture: the step t = 0, 1, ... counts
    discount**t, that of the capture included.

    Attributes:
        maze, rules: what is played; `rules.view_radius` and so on.
        opponent_table: [self cell, other cell, action] float64, the opponent.
        search: the bounds; its costs are the responder's, so an evader's are negative.
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
        """What a step counts in terms of the one before it."""
        return self.rules.discount

    @property
    def lower(self) -> float:
        """A proven lower bound of the optimum's mean over the starts; an evader reaches it."""
        return self.search.lower if self.role == "chaser" else -self.search.upper

    @property
    def upper(self) -> float:
        """A proven upper bound of the optimum's mean over the starts; a chaser reaches it."""
        return self.search.upper if self.role == "chaser" else -self.search.lower

    @property
    def width(self) -> float:
        """upper / lower - 1: how well the optimum is known."""
        return self.search.width

    @property
    def seconds(self) -> float:
        """Searched so far."""
        return self.search.seconds

    def bounds(self, own_cell: int, belief: ArrayLike) -> tuple[float, float]:
        """Proven bounds of the optimum from a belief.

        Args:
            own_cell: the responder's cell.
            belief: [cells], probabilities of the opponent's cell; an opponent in the own cell is
                caught.

        Raises:
            ValueError: no cell, or no distribution.
        """
        low, up = self.search.bounds(own_cell, belief)
        return (low, up) if self.role == "chaser" else (-up, -low)

    @cached_property
    def policy(self) -> BeliefOptimal:
        """A policy with the proven bound: a chaser at most `upper`, an evader at least `lower`.

        It is made of what was known when it was asked for first.
        """
        return POLICIES[self.role](self)

    def improve(
        self, seconds: float, width: float | None = None, report: Report | None = None
    ) -> None:
        """Search on, with the arguments of `solve_hidden_chase`; `policy` is made anew after it."""
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
    report: Report | None = None,
) -> HiddenChaseSolution:
    """Bound what an agent with limited sight can achieve against an opponent that plays a table.

    The responder knows the maze and the opponent's table, and sees the opponent where it is within
    view after the moves of a step, and at the start; the opponent sees everything. A chaser
    minimises the expected discounted steps until capture, an evader maximises them. At the start
    an opponent out of view is in any cell out of view, equally likely. Proven by `HiddenSearch`,
    for as long as it is let; the game has no end but capture.

    Args:
        maze: where it is played.
        opponent_table: [self cell, other cell, action], the opponent's probabilities.
        view_radius: path steps within which the responder sees; None for no such limit.
        line_of_sight: it sees along rows and columns until a wall only; with a radius both hold.
        discount: what a step counts in terms of the one before it; above 0 and below 1.
        seconds: to search, on one core; less when the bounds are as close as numbers can be.
        width: stop when upper / lower - 1 is at most so much.
        role: of the responder, "chaser" or "evader".
        stay_action: whether the responder has the fifth action; by default as the opponent does.
        move_order: as in `Task`.
        min_start_distance: least path distance at the start, as in `Task`.
        memory: bytes that the bounds take at most; when they are full, what says least is dropped.
        report: called regularly with the seconds and both bounds of the responder's costs.

    Raises:
        ValueError: an argument outside these limits, or a table of a wrong shape or with a row that
            is no distribution.
    """
    maze = load_maze(maze)
    if maze.num_cells > MAX_TABLE_CELLS:
        raise ValueError(f"{maze.name}: {maze.num_cells} cells; at most {MAX_TABLE_CELLS}")
    table = checked_table(maze, opponent_table, "opponent_table")
    rules = VisibilityRules(
        role,
        view_radius,
        line_of_sight,
        discount,
        move_order,
        table.shape[2] == 5 if stay_action is None else stay_action,
        min_start_distance,
    )
    solution = HiddenChaseSolution(
        maze, rules, table, HiddenSearch(hidden_chase(maze, table, rules), memory)
    )
    solution.search.improve(seconds, width, report)
    return solution


# -- the policy ------------------------------------------------------------------------------------


class OpponentTable:
    """A policy that is this table, in any task."""

    def __init__(self, table: NDArray[np.float64]) -> None:
        self.table = table

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64."""
        return self.table


class BeliefOptimal(BeliefAgent):
    """Plays the plans of a `HiddenChaseSolution`, as they are when it is made; a `MemoryPolicy`.

    In each game it keeps, by Bayes' rule (`BeliefFilter`), the exact distribution of the other's
    cell given all that was seen and not seen, and looks one step ahead to the plans' costs. So in
    expectation, against the opponent and from the starts it was solved for, it reaches the
    solution's bound, or better: `upper` as a chaser, `lower` as an evader. Against others it plays
    on by what can be. It sees by its own view radius, which the task's must allow, and never by
    more.

    Args:
        solution: of `solve_hidden_chase`.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
    """

    def __init__(self, solution: HiddenChaseSolution, epsilon: float = 0.0) -> None:
        rules, search = solution.rules, solution.search
        if rules.role != self.role:
            raise ValueError(
                f"{type(self).__name__} plays the {self.role}; this solution is the "
                f"{rules.role}'s: take its .policy"
            )
        opponent = OpponentTable(solution.opponent_table)
        super().__init__(BeliefFilter(opponent, rules.view_radius, rules.line_of_sight), epsilon)
        self.maze, self._rules, self._visible = solution.maze, rules, search.game.visible
        self._model, self._plans = search.model, search.plans()
        self._room = workspace_for(self._model, 0, self._plans.action.shape[1], 0)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._rules}, epsilon={self.epsilon:g})"

    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        moves, own = np.empty(view.num_games, dtype=np.uint8), view.positions[:, view.seat]
        choose_actions(
            self._model, self._plans, self._room, np.ascontiguousarray(own), belief, moves
        )
        return moves

    def _check(self, view: GameView) -> None:
        super()._check(view)
        task, rules = view.task, self._rules
        if not task.is_duel or task.mazes != (self.maze,):
            raise ValueError(
                f"{self!r} plays a duel in {self.maze.name}; task {task.name!r} is another game"
            )
        if (self._visible & ~task.sees(view.seat)).any():
            raise ValueError(
                f"{self!r} plays by a wider view than its seat of task {task.name!r}, which sees "
                "less; solve it for the radius of the task"
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


POLICIES: dict[Role, type[BeliefOptimal]] = {
    "chaser": BeliefOptimalChaser,
    "evader": BeliefOptimalEvader,
}
