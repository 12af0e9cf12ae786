"""Agents that play by the state of the whole game: what `solve_joint` finds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import GameView
from pursuit.rules.layout import Games
from pursuit.task import Task
from scripted_agents.joint_states import JointStates


class JointPlan:
    """A deterministic plan: what some agents do in every state, at every step where that matters.

    Args:
        states: of the game.
        seats: of the agents, whose plan it is.
        choices: [steps, states] uint8 or int16, joint actions: those of all seats, the last one's
            counting fastest. Beyond the last step the last row goes on.
    """

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
        """[num_games] int32, an action for every game; no random numbers are drawn.

        Raises:
            ValueError: games of another task, or a seat that it has no plan for.
        """
        return self._actions(view.task, view.games, view.seat)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, 1 for the action that it takes.

        Raises:
            ValueError: as `act`.
        """
        return np.eye(task.num_actions)[self._actions(task, games, seat)]

    def _actions(self, task: Task, games: Games, seat: int) -> NDArray[np.int32]:
        check_game(self, task, seat)
        numbers = self.states.numbers(games)
        step = np.minimum(games.steps, len(self.choices) - 1)
        joint = self.choices[step, np.maximum(numbers, 0)].astype(np.int64)
        later = len(self.seats) - 1 - self.seats.index(seat)
        own_part = joint // task.num_actions**later % task.num_actions
        return np.where(numbers < 0, 0, own_part).astype(np.int32)


class JointTable:
    """One agent's distribution over actions in every state of a game.

    Args:
        states: of the game.
        seat: of the agent.
        table: [states, actions] float64, rows that sum to 1 where a state can be.
    """

    def __init__(self, states: JointStates, seat: int, table: NDArray[np.float64]) -> None:
        self.states, self.seats, self.table = states, (seat,), table
        self.role = states.task.seat_roles[seat]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.states.task.agent_names[self.seats[0]]})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: games of another task, or another seat.
        """
        return drawn(view, self.distribution(view.task, view.games, view.seat))

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, its row of the table; the first action where a game is over.

        Raises:
            ValueError: as `act`.
        """
        check_game(self, task, seat)
        numbers = self.states.numbers(games)
        over = np.eye(task.num_actions)[0]
        return np.where((numbers < 0)[:, None], over, self.table[np.maximum(numbers, 0)])


def drawn(view: GameView, distribution: NDArray[np.float64]) -> NDArray[np.int32]:
    """[num_games] int32 from [num_games, actions]; one random number each, of the seat's stream."""
    chances = distribution.cumsum(axis=1)
    draws = view.uniform()[:, None] * chances[:, -1:]
    return np.asarray((draws >= chances[:, :-1]).sum(axis=1), dtype=np.int32)


def check_game(policy: JointPlan | JointTable, task: Task, seat: int) -> None:
    """ValueError unless a policy knows the states of this task, and plays in this seat."""
    own = policy.states.task
    fits = (task.mazes, task.teams, task.num_actions, task.move_order)
    if fits != (own.mazes, own.teams, own.num_actions, own.move_order):
        raise ValueError(
            f"{policy!r} is a plan for task {own.name!r} on {own.mazes[0].name}; task "
            f"{task.name!r} has another maze, other agents, goals, actions or order of moves"
        )
    if seat not in policy.seats:
        raise ValueError(
            f"{policy!r} has a plan for the seats {policy.seats}, not for {seat} "
            f"({task.agent_names[seat]})"
        )
