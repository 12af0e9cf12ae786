"""Where an opponent may be that is out of view, and a chaser that acts by it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.simulator.policy import GameView, Memory, TabularPolicy, check_plays, role_of
from pursuit.tasks.task import Task
from pursuit.validation import check_probability, number, one_of
from scripted_agents.agents.scripted import AStarEvader, draw_actions
from scripted_agents.agents.view_tables import ViewTables
from scripted_agents.duel.action_values import q_values
from scripted_agents.duel.best_response import MoveOrder, best_response, checked_table
from scripted_agents.hidden import belief_kernels
from scripted_agents.joint.optimal import table_of

Response = Literal["most_likely", "expected"]

RESPONSES = ("most_likely", "expected")

EQUALLY_LIKELY = 1e-9
"""Relative difference below which two cells count as equally likely."""

EQUALLY_GOOD = 1e-8
"""Relative difference below which two actions count as equally good."""


class BeliefFilter:
    """The exact Bayes filter over the opponent's cell in duels, for either side.

    At the start the opponent is believed in every cell out of view that is far enough away by the
    task's `min_start_distance`, all equally likely. Each step carries the belief on by the table of
    the opponent, which knows the own cell, given no capture; then the opponent is
    in view, or all cells in view are taken out. Where nothing is left (it does what it should not
    do), it may be in any cell out of view. Smallwood and Sondik (1973).

    Args:
        opponent: a table policy, the opponent model of the filter.
        view_radius, line_of_sight: as of `ViewTables`; the task's where left out.

    Raises:
        ValueError: an opponent that is no table, or a sight outside its limits.
    """

    def __init__(
        self, opponent: TabularPolicy, view_radius: int | None = None, line_of_sight: bool = False
    ) -> None:
        if not isinstance(opponent, TabularPolicy):
            raise ValueError(
                f"opponent={opponent!r} has no action_probabilities; a belief is carried on by the "
                "table of an opponent, such as AStarEvader(epsilon=0.2)"
            )
        self.opponent, self.view_tables = opponent, ViewTables(view_radius, line_of_sight)
        self.memory = Memory(_nothing_known)
        self._laid = Memory(self._lay_out)

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games of `view` (numbers [n] in it): their episodes begin now."""
        self.memory.of(view)["known_at"][view.rows[games]] = -1

    def update(self, view: GameView) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Take in what is in view now: the live beliefs, and which of their rows are the games'.

        Called once in a step; twice in the same one changes nothing.

        Returns:
            [batch, cells of the largest maze] float64, where `rows` [games] sum to 1: how likely
            the opponent is in each cell; and `rows` themselves.

        Raises:
            ValueError: games that are no duels, or in mazes too large for tables.
        """
        task, kept, rows = view.task, self.memory.of(view), view.rows
        check_duel(task, "beliefs")
        role = task.seat_roles[view.seat]
        belief_kernels.update_beliefs(
            view.games,
            view.seat,
            1 - view.seat,
            view.mazes,
            self.view_tables.table(view),
            self._laid.of(view)["chances"],
            (role == "chaser", task.move_order == "chasers_first", task.min_start_distance),
            rows,
            kept["belief"],
            kept["known_at"],
            kept["before"],
            self._laid.of(view)["room"],
        )
        return kept["belief"], rows

    def _lay_out(self, view: GameView) -> dict[str, NDArray[Any]]:
        tables = [
            self.opponent_table(view.task, maze).reshape(maze.num_cells**2, -1)
            for maze in view.task.mazes
        ]
        return {"chances": np.concatenate(tables), "room": np.zeros(view.task.max_cells)}

    def opponent_table(self, task: Task, maze: Maze) -> NDArray[np.float64]:
        """[other cell, own cell, action] float64: what the opponent is believed to play there."""
        table = table_of(self.opponent, maze, task.stay_action, task.move_order)
        return checked_table(maze, table, "the opponent's table")


class BeliefAgent(ABC):
    """The common ground of agents that act on what a `BeliefFilter` tells them.

    Args:
        beliefs: the filter.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
    """

    role = ""

    def __init__(self, beliefs: BeliefFilter, epsilon: float) -> None:
        self.filter, self.epsilon = beliefs, check_probability("epsilon", epsilon)

    @property
    def memory(self) -> Memory:
        """Its beliefs."""
        return self.filter.memory

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games of `view` (numbers [n] in it): their episodes begin now."""
        self.filter.begin(view, games)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: another role's seat, or games that it does not play.
        """
        self._check(view)
        belief, rows = self.filter.update(view)
        return draw_actions(view, self._moves(view, belief[rows]), self.epsilon)

    def _check(self, view: GameView) -> None:
        """ValueError where it does not play in a view."""
        check_plays(self, view.task, view.seat)

    @abstractmethod
    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        """[num_games] uint8, the moves that are best under `belief` [num_games, cells]."""


class BeliefChaser(BeliefAgent):
    """Believes where the evader is (`BeliefFilter`), and does what is best with full sight by it.

    It minimises the discounted steps until capture as if all were seen from the next step on: it
    never goes anywhere in order to see. So it bounds nothing, and what it loses by that is what
    the optimum of limited sight (a partially observed Markov decision process) gains.

    Args:
        opponent: a table policy, the model of the evader.
        response: "expected" takes the action of least expected value under the belief (QMDP;
            Littman, Cassandra and Kaelbling, 1995); "most_likely" answers the most likely cell by
            the best response. Of equally good actions, and of those against cells that are equally
            likely, one is drawn.
        view_radius: path steps that it sees; the task's where left out.
        line_of_sight: whether it sees along rows and columns only; the task's where left out.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        discount: of each step, above 0 and at most 1.

    Raises:
        ValueError: a setting outside these limits, or an opponent that is no table of an evader.
    """

    role = "chaser"

    def __init__(
        self,
        opponent: TabularPolicy | None = None,
        response: Response = "expected",
        view_radius: int | None = None,
        line_of_sight: bool = False,
        epsilon: float = 0.0,
        discount: float = 0.95,
    ) -> None:
        opponent = AStarEvader(epsilon=0.2) if opponent is None else opponent
        super().__init__(BeliefFilter(opponent, view_radius, line_of_sight), epsilon)
        if role_of(opponent) not in ("evader", None):
            raise ValueError(f"opponent={opponent!r} plays {role_of(opponent)}; give an evader")
        self.response: Response = one_of("response", response, RESPONSES)
        self.discount = number("discount", discount)
        if not 0.0 < self.discount <= 1.0:
            raise ValueError(f"discount={discount}; it lies above 0 and is at most 1")
        self._worth = Memory(self._worth_of)

    def __repr__(self) -> str:
        epsilon = f"epsilon={self.epsilon:g}" if self.epsilon else ""
        settings = [
            repr(self.filter.opponent),
            repr(self.response),
            repr(self.filter.view_tables),
            epsilon,
        ]
        return f"{type(self).__name__}({', '.join(filter(None, settings))})"

    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        kept, world, maze = self._worth.of(view), view.mazes.world, view.games.maze
        first = world.table[maze] + view.positions[:, view.seat] * world.num_cells[maze]
        if self.response == "most_likely":
            pairs = first[:, None] + np.arange(belief.shape[1])
            pairs = np.minimum(pairs, len(kept["best"]) - 1)  # beyond a small maze the belief is 0
            most = belief.max(axis=1, keepdims=True)
            likely = (belief > 0.0) & (belief >= most * (1.0 - EQUALLY_LIKELY))
            return np.bitwise_or.reduce(np.where(likely, kept["best"][pairs], 0), axis=1)
        masks, workspace = np.empty(view.num_games, dtype=np.uint8), np.empty(view.task.num_actions)
        sizes, most = world.num_cells[maze], 1.0 + EQUALLY_GOOD
        belief_kernels.least_expected(first, sizes, belief, kept["worth"], most, workspace, masks)
        return masks

    def _worth_of(self, view: GameView) -> dict[str, NDArray[Any]]:
        """What every action is worth at [own, other] with full sight, and which are best."""
        task = view.task
        order: MoveOrder = task.move_order  # type: ignore[assignment]
        worth = []
        for maze in task.mazes:
            table = self.filter.opponent_table(task, maze)
            rest = (None, self.discount, task.stay_action, order)
            values = best_response("chaser", maze, table, *rest).values
            steps = q_values("chaser", maze, table, values, task.num_actions, order, self.discount)
            worth.append(steps.reshape(-1, task.num_actions))
        every = np.concatenate(worth)
        return {"worth": np.ascontiguousarray(every.T), "best": _least(every)}


def _least(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """[n] uint8, the actions of least value in [n, actions] as bit masks, all that are as good."""
    good = values <= values.min(axis=1, keepdims=True) * (1.0 + EQUALLY_GOOD)
    return (good @ (1 << np.arange(values.shape[1]))).astype(np.uint8)


def _nothing_known(view: GameView) -> dict[str, NDArray[Any]]:
    """Beliefs of a batch before anything is seen."""
    games = view.num_games
    return {
        "belief": np.zeros((games, view.task.max_cells)),
        "known_at": np.full(games, -1, dtype=np.int32),
        "before": np.full(games, -1, dtype=np.int32),
    }


def why_no_belief(task: Task) -> str | None:
    """Why no belief of an opponent is kept in a task; None where one is."""
    return None if task.is_duel else "one chaser, one evader and no goals are needed"


def check_duel(task: Task, what: str) -> None:
    """ValueError where a task is no duel."""
    reason = why_no_belief(task)
    if reason is not None:
        raise ValueError(
            f"{what} in task {task.name!r} of {task.num_chasers} chaser(s), {task.num_evaders} "
            f"evader(s) and {task.num_goals} goal(s): {reason}. Take SearchingChaser"
        )
