"""The states of games by number, for tables of action values, and policies by such tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import comb
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pursuit.mazes.maze import Maze
from pursuit.observations.masks import bump_masks
from pursuit.observations.observations import Encoder
from pursuit.rules import Games
from pursuit.simulator.policy import GameView, pairs_of_cells
from pursuit.tasks.task import Task
from pursuit.validation import check
from train.networks.numbering_kernels import number_states

MAX_STATES = 20_000_000
"""Limit of a table's size: with four actions 320 MB, and as much for the visits."""


class SeatNumbering(ABC):
    """The states of a seat's game by number.

    Attributes:
        count: number of states, including unreachable ones.
        seat: the learner, a `Seat`; None if it is not known.
        goal_sets: number of sets with 0, 1, ... remaining goals, in the order of enumeration.
        for_kernels: the numbers that `number_states` takes.
        allowed: [cells, actions] bool, the allowed actions in each cell of the learner.
    """

    count: int
    seat: Any
    goal_sets: list[int]
    for_kernels: tuple[int, NDArray[np.int64]]
    allowed: NDArray[np.bool_]

    @abstractmethod
    def games(self, batch: Any) -> Games:
        """The games of a batch as kernels take them."""

    @abstractmethod
    def policy(self, q_values: NDArray[np.float64]) -> Any:
        """The greedy policy of a table [states, actions]; it follows changes of the table."""

    @abstractmethod
    def of_index(self, observation: Tensor) -> Tensor:
        """[games] int64: the state numbers of "index" observations [games, numbers]."""

    @abstractmethod
    def check(self, discount: float) -> None:
        """ValueError where a learner of values with this discount cannot use them."""

    def __call__(self, games: Games) -> NDArray[np.int64]:
        """[games] int64, the state number of every game."""
        states = np.empty(len(games.steps), dtype=np.int64)
        self.renumber(games, np.ones(len(states), dtype=bool), states)
        return states

    def renumber(self, games: Games, chosen: NDArray[np.bool_], states: NDArray[np.int64]) -> None:
        """Write the state numbers of the `chosen` games into `states` [games]."""
        number_states(*games, *self.for_kernels, chosen, states)


class StateNumbers(SeatNumbering):
    """The states of a task in one maze: the cells of all agents, and the sets of goals.

    Args:
        task: the game.
        agent: the learner, by name or role.
        mask_bumps: whether moves into walls are masked.
        seat: the learner's, as of `SeatNumbering`.

    Raises:
        ValueError: several mazes, or more than MAX_STATES states.
    """

    def __init__(
        self, task: Task, agent: str = "", mask_bumps: bool = False, seat: Any = None
    ) -> None:
        self.task, self.agent, self.seat = task, agent, seat
        if len(task.mazes) != 1:
            raise ValueError(
                f"q_learning needs a single maze, but this task has {len(task.mazes)}; use one "
                "maze, or an algorithm with a network"
            )
        goals, cells = task.num_goals, task.mazes[0].num_cells
        self.base = base = cells + 1 if task.num_agents > 2 else cells
        self.count = base**task.num_agents * sum(comb(cells, g) for g in range(goals + 1))
        if self.count > MAX_STATES:
            raise ValueError(
                f"q_learning needs a table of {self.count:,} states, but the limit is "
                f"{MAX_STATES:,}; use a smaller maze, fewer agents or goals, or an algorithm with "
                "a network"
            )
        self.goal_sets = [comb(cells, k) for k in range(goals + 1)]
        binomials = np.array(
            [[comb(n, k) for k in range(goals + 1)] for n in range(cells + 2)], dtype=np.int64
        )
        binomials[cells + 1] = sum(self.goal_sets)
        self.for_kernels = (cells, binomials)
        masks = bump_masks(task.mazes[0], task.num_actions)
        self.allowed = masks if mask_bumps else np.ones_like(masks)

    def games(self, batch: Any) -> Games:
        """As of `SeatNumbering`."""
        return batch.games

    def policy(self, q_values: NDArray[np.float64]) -> QTablePolicy:
        """As of `SeatNumbering`."""
        return QTablePolicy(self, q_values)

    def of_index(self, observation: Tensor) -> Tensor:
        """As of `SeatNumbering`; `number_state` with arrays of games."""
        task, (cells, binomials) = self.task, self.for_kernels
        agents, goals, sets = task.num_agents, task.num_goals, np.cumsum([0, *self.goal_sets])
        order = Encoder(task, "index").order[task.seat(self.agent)]
        # The cell of each entity; where it is absent, a number of at least `cells`.
        cell = (observation.long() - cells * torch.arange(observation.shape[1])).clamp(min=0)
        digits = torch.from_numpy(self.base ** (agents - 1 - order))
        state = (cell[:, :agents].clamp(max=self.base - 1) * digits).sum(1)
        goal = cell[:, agents : agents + goals]
        left = goal < cells
        rank = 1 + ((goal[:, None] < goal[:, :, None]) & left[:, None]).sum(2)
        ways = torch.from_numpy(binomials)[goal.clamp(max=cells), rank.clamp(max=goals)]
        number = (ways * left).sum(1) + torch.from_numpy(sets)[left.sum(1)]
        return state * int(sets[-1]) + number

    def check(self, discount: float) -> None:
        """As of `SeatNumbering`: not for drawn exits, turns, limited views, unbounded values."""
        task, agent = self.task, self.agent
        check(
            not task.num_exits and not task.options.turns,
            f"q_learning has a table over the cells of agents and goals, without num_exits="
            f"{task.num_exits} drawn exits or move_order={task.move_order!r}; use fixed exits and "
            "simultaneous moves or chasers_first, or an algorithm with a network",
        )
        check(
            not task.hides_from(agent),
            f"q_learning has a table over all states, but {agent} has a limited view; use another "
            "algorithm, or an unlimited view",
        )
        rewards = task.role_rewards[task.seat_roles[task.seat(agent)]]
        check(
            discount < 1.0 or (rewards.step <= 0.0 and rewards.distance <= 0.0),
            f"gamma={discount} with a positive reward of {agent} at every step makes values "
            "unbounded; use a lower gamma, such as 0.95",
        )


class QTablePolicy:
    """The greedy policy of a table; it follows changes of the table.

    Args:
        numbers: the states of the task that it was learned in.
        q_values: [states, actions] float64.
    """

    def __init__(self, numbers: StateNumbers, q_values: NDArray[np.float64]) -> None:
        self.task, self.agent = numbers.task, numbers.agent
        self.numbers, self.q_values, self.seat = numbers, q_values, numbers.seat

    def _best(self, games: Games, number: int) -> NDArray[np.int64]:
        """[games] the best allowed action of the agent with index `number`."""
        values = self.q_values[self.numbers(games)]
        return np.where(self.numbers.allowed[games.position[:, number]], values, -np.inf).argmax(
            axis=1
        )

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32: the best action, the lowest of equal ones.

        Raises:
            ValueError: games of another task.
        """
        own, other = self.task, view.task
        same = (
            "num_chasers",
            "num_evaders",
            "num_runners",
            "num_goals",
            "stay_action",
            "num_exits",
        )
        if own.mazes != other.mazes or any(getattr(own, n) != getattr(other, n) for n in same):
            raise ValueError(
                f"a table learned in task {own.name!r} on {own.mazes[0].name} cannot be used in "
                f"task {other.name!r} on {other.mazes[0].name}; use the same maze, agents, goals "
                "and actions"
            )
        if other.hides_from(view.seat):
            raise ValueError(
                f"a table over the states of task {own.name!r} needs full observability, but "
                f"{other.agent_names[view.seat]} has a limited view; use an unlimited view"
            )
        return self._best(view.games, view.seat).astype(np.int32)

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: 1 for the greedy action.

        Raises:
            ValueError: not a duel in this maze with these actions.
        """
        task = self.task
        if not task.is_duel or task.mazes != (maze,) or task.stay_action != stay_action:
            raise ValueError(
                f"a table learned in task {task.name!r} on {task.mazes[0].name} with "
                f"{task.num_actions} actions is not a table over pairs of cells of this maze; use "
                "one of a chaser against an evader in it"
            )
        best = self._best(pairs_of_cells(task, maze, self.agent), task.seat(self.agent))
        return np.eye(task.num_actions)[best].reshape(maze.num_cells, maze.num_cells, -1)
