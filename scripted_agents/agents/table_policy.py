"""Policies given as a table of action probabilities over pairs of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from pursuit.validation import as_array, check_bool, check_probability
from scripted_agents.agents import table_kernels
from scripted_agents.agents.scripted import RandomAgent


class TablePolicy:
    """Samples actions from table[own cell, other cell] in games of two agents.

    The other cell is that of the first active agent of another role; in a race that of the first
    other active runner. Exact solutions (`best_response(...).policy`) are such tables, and so are
    learned networks evaluated once on all pairs.

    Args:
        maze: the maze that the table belongs to.
        table: [cells, cells, actions], probabilities of the moves, or of the moves and stay.
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.

    Raises:
        ValueError: a wrong shape, negative entries, or rows that do not sum to 1.
    """

    def __init__(self, maze: Maze, table: ArrayLike, epsilon: float = 0.0) -> None:
        self.maze = load_maze(maze)
        self.table = checked_table(self.maze, table, "table")
        self.epsilon = check_probability("epsilon", epsilon)
        self._cumulative = self.table.cumsum(axis=2).reshape(-1, self.table.shape[2])
        self._offsets = np.zeros(1, dtype=np.int64)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream.

        Raises:
            ValueError: the games are in another maze, or have another number of actions.
        """
        task = view.task
        self._check(task.mazes, task.stay_action)
        actions = np.empty(view.num_games, dtype=np.int32)
        table_kernels.sample_table(
            view.games, view.streams, view.epsilon, view.seat, opponent_seats(task, view.seat),
            view.mazes, self._cumulative, self._offsets, self.epsilon, actions,
        )  # fmt: skip
        return actions

    def _check(self, mazes: tuple[Maze, ...], stay_action: bool) -> None:
        if mazes != (self.maze,):
            names = ", ".join(maze.name for maze in mazes)
            raise ValueError(
                f"the table is for maze {self.maze.name}, the games are in {names}; use that maze"
            )
        actions = self.maze.num_moves + stay_action
        if self.table.shape[2] != actions:
            raise ValueError(
                f"the table has {self.table.shape[2]} actions, the games have {actions}; "
                "use the same stay_action"
            )

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the row of each game, for its first active opponent.

        Raises:
            ValueError: other mazes, or another number of actions.
        """
        self._check(task.mazes, task.stay_action)
        table = self.action_probabilities(self.maze, task.stay_action)
        others = opponent_seats(task, seat)
        first = games.active[:, others].argmax(axis=1)
        other = np.take_along_axis(games.position[:, others], first[:, None], axis=1)[:, 0]
        return table[games.position[:, seat], other]

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the table, mixed with random moves by epsilon.

        Raises:
            ValueError: another maze, or another number of actions.
        """
        self._check((load_maze(maze),), check_bool("stay_action", stay_action))
        if self.epsilon == 0.0:
            return self.table.copy()
        random = RandomAgent().action_probabilities(self.maze, stay_action)
        return (1.0 - self.epsilon) * self.table + self.epsilon * random


def opponent_seats(task: Task, seat: int) -> NDArray[np.int64]:
    """The indices of agents of other roles; of all other agents if there is only one role.

    Raises:
        ValueError: there is no other agent.
    """
    role = task.seat_roles[seat]
    others = [other for other, theirs in enumerate(task.seat_roles) if theirs != role]
    others = others or [other for other in range(task.num_agents) if other != seat]
    if not others:
        raise ValueError(
            f"a table [self cell, other cell, action] in task {task.name!r}, with no agent but "
            f"{task.agent_names[seat]}; use a policy of a single agent, such as NearestGoalRunner"
        )
    return np.array(others, dtype=np.int64)


def checked_table(maze: Maze, table: ArrayLike, name: str) -> NDArray[np.float64]:
    """The table as contiguous float64; ValueError unless it is a valid table of this maze."""
    numbers = as_array(name, table, "biuf", "give probabilities")
    array = np.ascontiguousarray(numbers, dtype=np.float64)
    size = maze.num_cells
    moves = maze.num_moves
    shapes = (size, size, moves), (size, size, moves + 1)
    if array.shape not in shapes:
        raise ValueError(
            f"{name} has shape {array.shape}; {maze.name} with {size} cells needs "
            f"[self cell, other cell, action]: {shapes[0]}, or {shapes[1]} with stay"
        )
    wrong = ~(np.abs(array.sum(axis=2) - 1.0) <= 1e-6) | (array < 0.0).any(axis=2)
    np.fill_diagonal(wrong, False)
    if wrong.any():
        own, other = divmod(int(wrong.argmax()), size)
        row = array[own, other]
        raise ValueError(
            f"{name}: the probabilities for self cell {own} and other cell {other} "
            f"are {row.tolist()}, with sum {row.sum():.6g}; give non-negative ones with sum 1"
        )
    return array
