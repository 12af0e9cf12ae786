"""Agents that play exact solutions: the equilibrium of the chase, or the best response."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView, TabularPolicy, role_of
from pursuit.tasks.task import Task
from pursuit.validation import check_bool, check_discount, check_probability
from scripted_agents.agents.table_policy import TablePolicy
from scripted_agents.exact.duel.best_response import MoveOrder, best_response
from scripted_agents.exact.joint.equilibrium import solve_chase
from scripted_agents.exact.joint.policy import JointTable
from scripted_agents.exact.joint.states import joint_states_of
from scripted_agents.exact.limits import check_duel_order, check_optimal

Role = Literal["chaser", "evader"]


class ExactAgent(ABC):
    """Plays a table that is computed once for each maze and rules.

    Args:
        role: "chaser" or "evader".
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        discount: of each step in what it optimises.
        move_order: as in `Task`; that of a game has priority.

    Raises:
        ValueError: settings outside these limits.
    """

    def __init__(
        self,
        role: Role,
        epsilon: float = 0.0,
        discount: float = 0.95,
        move_order: MoveOrder = "simultaneous",
    ) -> None:
        if role not in ("chaser", "evader"):
            raise ValueError(f"role {role!r}; the roles here are 'chaser' and 'evader'")
        self.role: Role = role
        self.epsilon = check_probability("epsilon", epsilon)
        self.discount = check_discount(discount)
        check_duel_order(move_order)
        self.move_order = move_order
        self._players: dict[tuple[Maze, bool, str], TablePolicy] = {}
        self._teams: dict[tuple[Maze, bool, str, int], JointTable] = {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g})"

    @abstractmethod
    def solve(self, maze: Maze, stay_action: bool, move_order: MoveOrder) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, without random moves."""

    def solve_team(self, task: Task) -> NDArray[np.float64]:
        """[states, joint actions] float64 of a chaser team, or [states, actions] of the evader
        against one; states as of `joint_states_of`.

        Raises:
            ValueError: it is not known.
        """
        raise ValueError(
            f"{self!r} plays one against one; task {task.name!r} has {task.num_chasers} chaser(s) "
            f"and {task.num_evaders} evader(s). Take `best_team_response(...).policy`"
        )

    def policy_in(self, task: Task, seat: int | None = None) -> TablePolicy | JointTable:
        """What it plays in the games of a task, solved once; a `JointTable` but in duels.

        Raises:
            ValueError: another role's seat, several mazes, or a game in which it is not known.
        """
        if seat is not None and task.seat_roles[seat] != self.role:
            raise ValueError(
                f"{self!r} is a {self.role}; this seat is another's: {task.seat_roles[seat]}"
            )
        if len(task.mazes) > 1:
            raise ValueError(f"{self!r} plays in one maze; this task has {len(task.mazes)}")
        maze, order = task.mazes[0], task.move_order
        if task.is_duel:
            return self._player(maze, task.stay_action, order)
        check_optimal(task, self.role)
        key = (maze, task.stay_action, order, task.num_chasers)
        if key not in self._teams:
            states, table = joint_states_of(task), self.solve_team(task)
            seats = tuple(s for s, role in enumerate(task.seat_roles) if role == self.role)
            self._teams[key] = JointTable(states, seats, table, self.epsilon)
        return self._teams[key]

    def _player(self, maze: Maze, stay_action: bool, move_order: str) -> TablePolicy:
        key = (maze, stay_action, move_order)
        if key not in self._players:
            table = self.solve(maze, stay_action, move_order)  # type: ignore[arg-type]
            self._players[key] = TablePolicy(maze, table, self.epsilon)
        return self._players[key]

    def table(self, maze: Maze, stay_action: bool, move_order: str) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: what it plays under that order of moves."""
        player = self._player(maze, bool(stay_action), move_order)
        return player.action_probabilities(maze, bool(stay_action))

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: as `policy_in`.
        """
        return self.policy_in(view.task, view.seat).act(view)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, what it plays in a seat of these games.

        Raises:
            ValueError: as `policy_in`.
        """
        return self.policy_in(task, seat).distribution(task, games, seat)

    def joint_distribution(self, task: Task, games: Games) -> NDArray[np.float64]:
        """[games, joint actions] float64: what a team of it plays, drawn together.

        Raises:
            ValueError: as `policy_in`.
        """
        policy = self.policy_in(task)
        if isinstance(policy, JointTable):
            return policy.joint_distribution(task, games)
        return policy.distribution(task, games, task.seat(self.role))

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, for the agent's own move order."""
        return self.table(load_maze(maze), check_bool("stay_action", stay_action), self.move_order)


class _Equilibrium(ExactAgent):
    """One side of an equilibrium of the discounted chase (`solve_chase`)."""

    side: Role

    def __init__(
        self, epsilon: float = 0.0, discount: float = 0.95, move_order: MoveOrder = "simultaneous"
    ) -> None:
        super().__init__(self.side, epsilon, discount, move_order)

    def solve(self, maze: Maze, stay_action: bool, move_order: MoveOrder) -> NDArray[np.float64]:
        """Its policy in `solve_chase`."""
        solution = solve_chase(maze, self.discount, stay_action, None, move_order)
        return solution.chaser_policy if self.side == "chaser" else solution.evader_policy

    def solve_team(self, task: Task) -> NDArray[np.float64]:
        """Its policy in `solve_chase` for the team."""
        order: MoveOrder = task.move_order  # type: ignore[assignment]
        rest = (task.stay_action, None, order, task.num_chasers)
        solution = solve_chase(task.mazes[0], self.discount, *rest)
        policy = solution.chaser_policy
        if self.side == "evader":
            policy = np.moveaxis(solution.evader_policy, 0, -2)
        return policy.reshape(-1, policy.shape[-1])


class OptimalChaser(_Equilibrium):
    """The chaser of an equilibrium of the discounted chase (a minimax policy).

    A team of them against one evader plays the equilibrium of the team as one player: all chasers
    must use it. It raises an error if that is not known (`check_optimal`).

    Args:
        epsilon: share of random moves in [0, 1].
        discount: of each step in the game that is solved (`solve_chase`).
        move_order: of `action_probabilities`; in games it plays by theirs.
    """

    side = "chaser"


class OptimalEvader(_Equilibrium):
    """The evader of an equilibrium of the discounted chase, as `OptimalChaser` is the chaser.

    Against several chasers it is that of the game against the team as one player.
    """

    side = "evader"


class BestResponder(ExactAgent):
    """The exact best response to a given opponent, in games of one against one.

    Args:
        opponent: a policy that is a table: scripted, exact or learned.
        role: this agent's; left out it is the opposite of the opponent's, where that has one.
        epsilon: share of random moves in [0, 1].
        discount: of each step in what it optimises.
        move_order: of `action_probabilities`; in games it plays by theirs.

    Raises:
        ValueError: an opponent that is not a table, or has an unknown role.
    """

    def __init__(
        self,
        opponent: TabularPolicy,
        role: Role | None = None,
        epsilon: float = 0.0,
        discount: float = 0.95,
        move_order: MoveOrder = "simultaneous",
    ) -> None:
        if not isinstance(opponent, TabularPolicy):
            raise ValueError(
                f"opponent={opponent!r} has no action_probabilities; only a policy that is a table "
                "over pairs of cells has an exact best response"
            )
        if role is None:
            other = role_of(opponent)
            if other not in ("chaser", "evader"):
                raise ValueError(f"{opponent!r} plays either role; say which one responds to it")
            role = "evader" if other == "chaser" else "chaser"
        super().__init__(role, epsilon, discount, move_order)
        self.opponent = opponent

    def solve(self, maze: Maze, stay_action: bool, move_order: MoveOrder) -> NDArray[np.float64]:
        """The stationary best response."""
        table = table_of(self.opponent, maze, stay_action, move_order)
        arguments = (None, self.discount, stay_action, move_order)
        return best_response(self.role, maze, table, *arguments).policy


def table_of(
    policy: TabularPolicy, maze: Maze, stay_action: bool, move_order: str
) -> NDArray[np.float64]:
    """[self cell, other cell, action] float64: what a policy plays under these rules."""
    if isinstance(policy, ExactAgent):
        return policy.table(maze, stay_action, move_order)
    if not isinstance(policy, TabularPolicy):
        raise ValueError(f"policy={policy!r}; give a policy with action_probabilities")
    return policy.action_probabilities(maze, stay_action)
