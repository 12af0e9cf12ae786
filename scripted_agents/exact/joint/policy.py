"""Policies over the states of a whole game: deterministic plans, and tables of distributions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.agents.table_kernels import draw_together
from scripted_agents.exact.joint.states import JointStates


class JointPlan:
    """A deterministic plan: what some agents do in every state, at every step where that matters.

    It moves at random only where the simulator sets an epsilon for its seat.

    Args:
        states: of the game.
        seats: the indices of the agents.
        choices: [steps, states] uint8 or int16, joint actions: those of all seats, the last one's
            counting fastest. Beyond the last step the last row goes on.
    """

    epsilon = 0.0

    def __init__(
        self, states: JointStates, seats: tuple[int, ...], choices: NDArray[np.integer]
    ) -> None:
        self.states, self.seats, self.choices = states, seats, choices
        roles = {states.task.seat_roles[seat] for seat in seats}
        if len(roles) == 1:
            self.role = roles.pop()

    def __repr__(self) -> str:
        names = ", ".join(self.states.task.agent_names[seat] for seat in self.seats)
        return f"{type(self).__name__}({names})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game.

        Raises:
            ValueError: games of another task, or a seat that it has no plan for.
        """
        chosen = self._actions(view.task, view.games, view.seat)
        return with_random_moves(view, chosen, self.epsilon)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, 1 for the action that it takes.

        Raises:
            ValueError: as `act`.
        """
        return np.eye(task.num_actions)[self._actions(task, games, seat)]

    def _actions(self, task: Task, games: Games, seat: int) -> NDArray[np.int64]:
        check_game(self, task, seat)
        numbers = self.states.numbers(games)
        step = np.minimum(games.steps, len(self.choices) - 1)
        joint = self.choices[step, np.maximum(numbers, 0)].astype(np.int64)
        return np.where(numbers < 0, 0, _part_of(self, joint, seat))


class JointTable:
    """What some agents play in every state of a game: distributions over their joint actions.

    Several agents draw their joint action together, from a random number that each of them finds
    for itself in the state of the game. So all of them must be filled by this policy for their
    joint play to be this table; an agent alone plays its marginal distribution.

    Args:
        states: of the game.
        seats: of the agents, all of one role.
        table: [states, joint actions] float64, rows that sum to 1 where a state can be; the last
            seat's action counts fastest.
        epsilon: share of random moves of each agent; the simulator's own of a game goes first.
    """

    def __init__(
        self,
        states: JointStates,
        seats: tuple[int, ...],
        table: NDArray[np.float64],
        epsilon: float = 0.0,
    ) -> None:
        self.states, self.seats, self.table, self.epsilon = states, seats, table, float(epsilon)
        self.role = states.task.seat_roles[seats[0]]
        self._cumulative = table.cumsum(axis=1)

    def __repr__(self) -> str:
        names = ", ".join(self.states.task.agent_names[seat] for seat in self.seats)
        return f"{type(self).__name__}({names})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: games of another task, or another seat.
        """
        check_game(self, view.task, view.seat)
        numbers = self.states.numbers(view.games)
        draws = np.empty(view.num_games)
        if len(self.seats) > 1:
            draw_together(view.streams, view.task.num_agents, view.steps, self.seats[0], draws)
        else:
            draws = view.uniform()
        joint = drawn(draws, self._cumulative[np.maximum(numbers, 0)])
        own = np.where(numbers < 0, 0, _part_of(self, joint, view.seat))
        return with_random_moves(view, own, self.epsilon)

    def joint_distribution(self, task: Task, games: Games) -> NDArray[np.float64]:
        """[games, joint actions] float64; the first action where a game is over.

        Raises:
            ValueError: as `act`.
        """
        check_game(self, task, self.seats[0])
        numbers = self.states.numbers(games)
        over = np.eye(self.table.shape[1])[0]
        joint = np.where((numbers < 0)[:, None], over, self.table[np.maximum(numbers, 0)])
        epsilons = [self.epsilon] * len(self.seats)
        return mixed_with_random_moves(task, self.seats, epsilons, games.position, joint)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, the marginal distribution of one agent.

        Raises:
            ValueError: as `act`.
        """
        check_game(self, task, seat)
        return marginal(self.joint_distribution(task, games), task, self.seats, (seat,))


def drawn(draws: NDArray[np.float64], cumulative: NDArray[np.float64]) -> NDArray[np.int64]:
    """[games] int64: the option that each uniform number in [0, 1) falls to.

    `cumulative` [games, options] are sums of the chances of the options.
    """
    return np.asarray((draws[:, None] * cumulative[:, -1:] >= cumulative[:, :-1]).sum(axis=1))


@lru_cache(maxsize=8)
def random_moves(maze: Maze, num_actions: int) -> NDArray[np.float64]:
    """[cells, actions] float64: uniform over the moves that change the cell, as `RandomAgent`
    plays; an enclosed agent stays, or bumps into the north wall."""
    moves = (maze.neighbors[:, :num_actions] != np.arange(maze.num_cells)[:, None]).astype(float)
    moves[moves.sum(axis=1) == 0.0, -1 if num_actions > maze.num_moves else 0] = 1.0
    return np.asarray(moves / moves.sum(axis=1, keepdims=True))


def mixed_with_random_moves(
    task: Task,
    seats: tuple[int, ...],
    chances: Sequence[float],
    cells: NDArray[Any],
    rows: NDArray[np.float64],
) -> NDArray[np.float64]:
    """[games, joint actions] float64: distributions over the joint actions of these agents, each of
    which is replaced by a random move with the chance of its agent, independent of the others.

    `cells` [games, agents] are the positions of all agents.
    """
    if not any(chances):
        return rows
    uniform = random_moves(task.mazes[0], task.num_actions)
    rows = rows.reshape(-1, *(task.num_actions,) * len(seats))
    for axis, (seat, chance) in enumerate(zip(seats, chances, strict=True), start=1):
        shape = [-1] + [task.num_actions if a == axis else 1 for a in range(1, rows.ndim)]
        moves = uniform[cells[:, seat]].reshape(shape)
        rows = (1.0 - chance) * rows + chance * rows.sum(axis=axis, keepdims=True) * moves
    return rows.reshape(len(rows), -1)


def marginal(
    joint: NDArray[np.float64], task: Task, team: Sequence[int], seats: Sequence[int]
) -> NDArray[np.float64]:
    """[games, joint actions of `seats`] float64, given the distributions of a whole team."""
    parts = joint.reshape(-1, *(task.num_actions,) * len(team))
    others = tuple(axis for axis, seat in enumerate(team, start=1) if seat not in seats)
    return np.asarray(parts.sum(axis=others).reshape(len(joint), -1), dtype=np.float64)


def with_random_moves(
    view: GameView, chosen: NDArray[np.int64], default: float
) -> NDArray[np.int32]:
    """[games] int32: `chosen`, or with a game's epsilon (`default` where it is NaN) a random move.

    Two numbers of the seat's own stream are drawn in every game, independent of other games.
    """
    epsilon = view.epsilon[:, view.seat]
    random = view.uniform() < np.where(np.isnan(epsilon), default, epsilon)
    draws = view.uniform()
    moves = random_moves(view.task.mazes[0], view.task.num_actions)
    moved = drawn(draws, moves[view.positions[:, view.seat]].cumsum(axis=1))
    return np.where(random, moved, chosen).astype(np.int32)


def _part_of(
    policy: JointPlan | JointTable, joint: NDArray[np.int64], seat: int
) -> NDArray[np.int64]:
    """One agent's actions in joint actions."""
    actions = policy.states.task.num_actions
    later = len(policy.seats) - 1 - policy.seats.index(seat)
    return joint // actions**later % actions


def check_game(policy: JointPlan | JointTable, task: Task, seat: int) -> None:
    """ValueError unless a policy has the states of this task, and is for this agent."""
    own = policy.states.task
    rules_of = attrgetter("mazes", "teams", "num_actions", "move_order", "fixed_exits")
    if rules_of(task) != rules_of(own) or task.num_exits != own.num_exits:
        raise ValueError(
            f"{policy!r} is a plan for task {own.name!r} on {own.mazes[0].name}; task "
            f"{task.name!r} has another maze, other agents, goals, actions or order of moves"
        )
    if seat not in policy.seats:
        raise ValueError(
            f"{policy!r} has a plan for the seats {policy.seats}, not for {seat} "
            f"({task.agent_names[seat]})"
        )
