"""Agents that see only near cells and play by a belief of where the other may be."""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import share
from pursuit.maze import Maze
from pursuit.policy import GameView, Memory
from scripted_agents.hidden_game import SightRules
from scripted_agents.hidden_play_kernels import play_beliefs
from scripted_agents.hidden_search import HiddenSearch

NONE = -1


class Solved(Protocol):
    """What is asked of a `HiddenChaseSolution`."""

    @property
    def maze(self) -> Maze: ...  # noqa: D102 -- as there

    @property
    def rules(self) -> SightRules: ...  # noqa: D102

    @property
    def search(self) -> HiddenSearch: ...  # noqa: D102


def _nothing(hidden: int, view: GameView) -> dict[str, NDArray[Any]]:
    """What is remembered when nothing has been seen."""
    games = view.num_games
    return {"belief": np.zeros((games, hidden)), "before": np.full(games, NONE, dtype=np.int64)}


class BeliefOptimal:
    """Plays the plans of a `HiddenChaseSolution`, as they are when it is made; a `MemoryPolicy`.

    In each game it keeps, by Bayes' rule, the exact distribution of the other's cell given all that
    was seen and not seen, and looks one step ahead to the plans' costs. So in expectation, against
    the opponent and from the starts it was solved for, it reaches the solution's bound, or better:
    `upper` as a chaser, `lower` as an evader. Against others it plays on by what can be, and where
    what it sees cannot be it believes what it did at the start. It sees by its own view radius,
    which the task's must allow, and never by more.

    Args:
        solution: of `solve_hidden_chase`.
        epsilon: share of random moves in [0, 1]; the simulator's own epsilon of a game goes first.

    Attributes:
        memory: "belief" [games, cells] float64, the distribution of the other's cell, and "before"
            [games], the own cell in the step before; NONE at a start.
    """

    role = ""

    def __init__(self, solution: Solved, epsilon: float = 0.0) -> None:
        if solution.rules.role != self.role:
            raise ValueError(
                f"{type(self).__name__} plays the {self.role}; this solution is the "
                f"{solution.rules.role}'s: take its .policy"
            )
        search = solution.search
        self.maze, self.epsilon = solution.maze, share("epsilon", epsilon)
        self._rules = solution.rules
        self._visible, self._model = search.game.visible, search.model
        self._plans, self._starts = search.plans(), _start_beliefs(solution)
        hidden = self._visible.shape[1]
        self._rest, self._after = np.zeros(hidden), np.zeros(self._model.cells.shape[1])
        self._product = np.zeros(self._plans.vectors.shape[2])
        self.memory = Memory(partial(_nothing, hidden))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._rules}, epsilon={self.epsilon:g})"

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games."""
        self.memory.of(view)["before"][view.rows[games]] = NONE

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: another role's seat, another maze, or other rules than it was solved for.
        """
        self._check(view)
        seat, memory = view.seat, self.memory.of(view)
        own, other = view.positions[:, seat], view.positions[:, 1 - seat]
        shown = self._visible[own, other]
        epsilon = view.epsilon[:, seat]
        actions = np.empty(view.num_games, dtype=np.int32)
        play_beliefs(
            self._model,
            self._plans,
            self._starts,
            own.astype(np.int64),
            np.where(shown, other, NONE).astype(np.int64),
            ~view.active.all(axis=1),
            view.rows.astype(np.int64),
            memory["belief"],
            memory["before"],
            np.where(np.isnan(epsilon), self.epsilon, epsilon),
            view.uniform(),
            view.uniform(),
            self._rest,
            self._after,
            self._product,
            actions,
        )
        return actions

    def _check(self, view: GameView) -> None:
        task, rules = view.task, self._rules
        if task.seat_roles[view.seat] != self.role:
            raise ValueError(
                f"{self!r} is a {self.role}; this seat is another's: {task.seat_roles[view.seat]}"
            )
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


def _start_beliefs(solution: Solved) -> NDArray[np.float64]:
    """[own, hidden], what is believed at the start where nobody is seen; 0 where all is seen."""
    game = solution.search.game
    hidden = (~game.visible).astype(np.float64)
    beliefs = hidden / np.maximum(hidden.sum(axis=1, keepdims=True), 1.0)
    blind = (game.starts.seen == NONE) & (game.start_weights > 0.0)
    beliefs[game.start_cells[blind]] = game.start_beliefs[blind]
    return beliefs
