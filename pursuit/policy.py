"""The Policy protocol, and GameView: what whoever fills a seat may see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pursuit import rules
from pursuit.maze import Maze
from pursuit.task import Task


@dataclass(frozen=True, eq=False)
class GameView:
    """A batch of games seen from one seat: live arrays of the `Simulator`, not copies.

    Attributes:
        task: the rules and settings.
        seat: which agent this is.
        rows: [num_games, ...] int32, the games as the rule book lays them out.
        streams: [num_games, ...] uint64, the random streams; a policy draws from column 1 + seat.
        epsilons: [num_games, num_agents] float64, the share of random moves; NaN where the game
            leaves it to the policy.
        mazes, cells, tables: the mazes as the rule book lays them out.
        observe: `observe(encoding)` -> [num_games, ...] what the agent in this seat observes.
    """

    task: Task
    seat: int
    rows: NDArray[np.int32]
    streams: NDArray[np.uint64]
    epsilons: NDArray[np.float64]
    mazes: NDArray[np.int64]
    cells: NDArray[np.int32]
    tables: NDArray[np.uint16]
    observe: Callable[[str], NDArray[Any]]

    @property
    def num_games(self) -> int:
        """Games in the batch."""
        return len(self.rows)

    @property
    def positions(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, the cell of every agent."""
        return self.rows[:, : self.task.num_agents]

    @property
    def active(self) -> NDArray[np.bool_]:
        """[num_games, num_agents] bool, False for captured evaders."""
        agents = self.task.num_agents
        return self.rows[:, agents : 2 * agents] != 0

    @property
    def goals(self) -> NDArray[np.int32]:
        """[num_games, num_goals] int32, the cell of every goal; -1 when gone."""
        agents, goals = self.task.num_agents, self.task.num_goals
        return self.rows[:, 3 * agents : 3 * agents + goals]

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps taken in the episode."""
        return self.rows[:, -2]

    @property
    def maze_index(self) -> NDArray[np.int32]:
        """[num_games] int32, which of `task.mazes` each game plays in."""
        return self.rows[:, -1]

    def select(self, games: NDArray[np.intp]) -> GameView:
        """Copies of these games as a view of their own.

        Whoever lets a policy draw from it puts the streams back:
        `view.streams[games] = part.streams`.
        """
        return replace(
            self,
            rows=self.rows[games],
            streams=self.streams[games],
            epsilons=self.epsilons[games],
            observe=lambda encoding: self.observe(encoding)[games],
        )

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from this seat's own random stream, which moves on."""
        numbers = np.empty(self.num_games)
        rules.draw_uniform(self.streams, 1 + self.seat, numbers)
        return numbers


class Policy(Protocol):
    """Whoever fills a seat: scripted, exact or learned."""

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game.

        Draw random numbers from `view.uniform()` (or the seat's stream) only, so that a game does
        not depend on the batch that it is in.
        """
        ...


@runtime_checkable
class TabularPolicy(Protocol):
    """A policy that is a function of (own cell, other cell) in games of one against one."""

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, the exact distribution over actions."""
        ...
