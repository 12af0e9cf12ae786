"""Beliefs about the cell of an opponent that is out of view, and a chaser that acts on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.rules.arrays import Array
from pursuit.rules.layout import NUM_CELLS, TABLE
from pursuit.simulator.policy import GameView, Memory, TabularPolicy, check_plays, role_of
from pursuit.tasks.task import Task
from pursuit.validation import check_discount, check_probability, one_of
from scripted_agents.agents.scripted import AStarEvader, draw_actions
from scripted_agents.agents.table_policy import checked_table
from scripted_agents.agents.view_tables import ViewTables
from scripted_agents.exact.duel.action_values import q_values
from scripted_agents.exact.duel.best_response import MoveOrder, best_response
from scripted_agents.exact.hidden import belief_kernels
from scripted_agents.exact.joint.optimal import table_of
from scripted_agents.exact.limits import check_belief
from scripted_agents.exact.tolerances import EQUAL_VALUES

Response = Literal["most_likely", "expected"]

RESPONSES = ("most_likely", "expected")

EQUALLY_GOOD = 1e-8
"""Relative difference below which two actions count as equally good."""


class BeliefFilter:
    """The exact Bayes filter over the opponent's cell in duels, for either side.

    The initial belief is uniform over the cells out of view at the task's `min_start_distance` or
    farther. A step predicts the belief by the table of the opponent, which sees the agent, given
    that there is no capture. Then the opponent is visible, or all visible cells are removed. If
    nothing is left, as the opponent deviates from its table, the belief is uniform over the cells
    out of view. Smallwood and Sondik (1973).

    Args:
        opponent: a tabular policy, the opponent model of the filter.
        view_radius, line_of_sight: as of `ViewTables`; by default those of the task.

    Raises:
        ValueError: an opponent that is no table, or invalid view limits.
    """

    def __init__(
        self, opponent: TabularPolicy, view_radius: int | None = None, line_of_sight: bool = False
    ) -> None:
        if not isinstance(opponent, TabularPolicy):
            raise ValueError(
                f"opponent={opponent!r} has no action_probabilities; give a tabular policy, such "
                "as AStarEvader(epsilon=0.2)"
            )
        self.opponent, self.view_tables = opponent, ViewTables(view_radius, line_of_sight)
        self.memory = Memory(_nothing_known)
        self._laid = Memory(self._lay_out)

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Clear the memory of `games` [n] (indices in `view`), in which new episodes start."""
        self.memory.of(view)["known_at"][view.rows[games]] = -1

    def update(self, view: GameView) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Update the beliefs by the current observations; call it once per step.

        A second call in the same step changes nothing.

        Returns:
            The beliefs [batch, cells of the largest maze] float64, not a copy: the probability of
            each cell, where the rows of these games sum to 1; and these rows [games].

        Raises:
            ValueError: games that are no duels, or mazes that are too large for tables.
        """
        task, kept, rows = view.task, self.memory.of(view), view.rows
        check_belief(task, "beliefs")
        chases, laid = task.seat_roles[view.seat] == "chaser", self._laid.of(view)
        settings = chases, task.move_order == "chasers_first", task.min_start_distance
        belief_kernels.update_beliefs(
            view.games, view.seat, 1 - view.seat, view.mazes, self.view_tables.table(view),
            laid["chances"], settings, rows, kept["belief"], kept["known_at"], kept["before"],
            laid["scratch"],
        )  # fmt: skip
        return kept["belief"], rows

    def _lay_out(self, view: GameView) -> dict[str, Array]:
        tables = [
            self.opponent_table(view.task, maze).reshape(maze.num_cells**2, -1)
            for maze in view.task.mazes
        ]
        return {"chances": np.concatenate(tables), "scratch": np.zeros(view.task.max_cells)}

    def opponent_table(self, task: Task, maze: Maze) -> NDArray[np.float64]:
        """[other cell, own cell, action] float64: the opponent model in a maze."""
        table = table_of(self.opponent, maze, task.stay_action, task.move_order)
        return checked_table(maze, table, "the opponent's table")


class BeliefAgent(ABC):
    """The base class of agents that act on the beliefs of a `BeliefFilter`.

    Args:
        beliefs: the filter.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
    """

    role = ""

    def __init__(self, beliefs: BeliefFilter, epsilon: float) -> None:
        self.filter, self.epsilon = beliefs, check_probability("epsilon", epsilon)

    @property
    def memory(self) -> Memory:
        """The memory of the filter."""
        return self.filter.memory

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Clear the memory of `games` [n] (indices in `view`), in which new episodes start."""
        self.filter.begin(view, games)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: an agent of another role, or games that it does not support.
        """
        self._check(view)
        belief, rows = self.filter.update(view)
        return draw_actions(view, self._moves(view, belief[rows]), self.epsilon)

    def _check(self, view: GameView) -> None:
        """ValueError unless it supports the games of a view."""
        check_plays(self, view.task, view.seat)

    @abstractmethod
    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        """[num_games] uint8, the moves that are best under `belief` [num_games, cells]."""


class BeliefChaser(BeliefAgent):
    """Takes the actions with the best full-view values under its belief about the evader.

    It minimises the discounted steps until capture as if the view were full from the next step on,
    so it never moves to gain information. Its values bound the optimum of the partially observable
    Markov decision process on neither side.

    Args:
        opponent: a tabular policy, the model of the evader.
        response: "expected" takes the action of least expected value under the belief (QMDP;
            Littman, Cassandra and Kaelbling, 1995); "most_likely" takes the best response to the
            most likely cell. Ties are broken uniformly.
        view_radius: path distance up to which cells are visible; by default as in the task.
        line_of_sight: whether cells are visible only along rows and columns; by default as in the
            task.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        discount: of each step, above 0 and at most 1.

    Raises:
        ValueError: an invalid setting, or an opponent that is no tabular evader.
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
        self.discount = check_discount(discount)
        self._q_values = Memory(self._q_values_of)

    def __repr__(self) -> str:
        settings = [*map(repr, (self.filter.opponent, self.response, self.filter.view_tables))]
        settings += [f"epsilon={self.epsilon:g}"] * (self.epsilon > 0.0)
        return f"{type(self).__name__}({', '.join(filter(None, settings))})"

    def _moves(self, view: GameView, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
        kept, world, maze = self._q_values.of(view), view.mazes, view.games.maze
        first = (
            world.mazes[TABLE, maze] + view.positions[:, view.seat] * world.mazes[NUM_CELLS, maze]
        )
        if self.response == "most_likely":
            pairs = first[:, None] + np.arange(belief.shape[1])
            pairs = np.minimum(pairs, len(kept["best"]) - 1)  # beyond a small maze the belief is 0
            most = belief.max(axis=1, keepdims=True)
            likely = (belief > 0.0) & (belief >= most * (1.0 - EQUAL_VALUES))
            return np.bitwise_or.reduce(np.where(likely, kept["best"][pairs], 0), axis=1)
        masks, workspace = np.empty(view.num_games, dtype=np.uint8), np.empty(view.task.num_actions)
        sizes, most = world.mazes[NUM_CELLS, maze], 1.0 + EQUALLY_GOOD
        belief_kernels.least_expected(
            first, sizes, belief, kept["q_values"], most, workspace, masks
        )
        return masks

    def _q_values_of(self, view: GameView) -> dict[str, Array]:
        """The full-view values of all actions at [own, other], and the masks of optimal ones."""
        task = view.task
        order: MoveOrder = task.move_order  # type: ignore[assignment]
        tables = []
        for maze in task.mazes:
            table = self.filter.opponent_table(task, maze)
            rest = (None, self.discount, task.stay_action, order)
            values = best_response("chaser", maze, table, *rest).values
            steps = q_values("chaser", maze, table, values, task.num_actions, order, self.discount)
            tables.append(steps.reshape(-1, task.num_actions))
        every = np.concatenate(tables)
        return {"q_values": np.ascontiguousarray(every.T), "best": _least(every)}


def _least(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """[n] uint8, the bit masks of the actions of least value in [n, actions], including ties."""
    good = values <= values.min(axis=1, keepdims=True) * (1.0 + EQUALLY_GOOD)
    return (good @ (1 << np.arange(values.shape[1]))).astype(np.uint8)


def _nothing_known(view: GameView) -> dict[str, Array]:
    """The memory of a batch without beliefs."""
    games = view.num_games
    return {
        "belief": np.zeros((games, view.task.max_cells)),
        "known_at": np.full(games, -1, dtype=np.int32),
        "before": np.full(games, -1, dtype=np.int32),
    }
