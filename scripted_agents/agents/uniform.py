"""The agent that draws from all actions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.layout import Games, World
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.agents.scripted import Scripted, draw_actions


class UniformAgent(Scripted):
    """Uniformly random among all actions: stay, and moves into walls, which keep the cell, too.

    So do the evaders of PettingZoo's `pursuit_v5`. An epsilon set in the simulator is the share of
    actions that are drawn among the moves that change the cell instead, as by `RandomAgent`.
    """

    def __init__(self) -> None:
        super().__init__(epsilon=0.0)

    def _fill(
        self,
        view: GameView,
        seats: tuple[int, ...],
        columns: tuple[int, ...],
        actions: NDArray[np.int32],
    ) -> None:
        every = np.full(view.num_games, (1 << view.task.num_actions) - 1)
        for seat, column in zip(seats, columns, strict=True):
            actions[:, column] = draw_actions(replace(view, seat=seat), every, self.epsilon)

    def moves(self, task: Task, games: Games, seat: int) -> NDArray[np.int64]:
        """As `Scripted.moves`; the greedy moves are all actions."""
        moves = super().moves(task, games, seat)
        moves[:, 0] = (1 << task.num_actions) - 1
        return moves

    def _greedy_table(self, mazes: World, stay_action: bool) -> NDArray[Any]:
        actions = mazes.neighbors.shape[1] - 1 + stay_action
        return np.full(len(mazes.tables), (1 << actions) - 1, dtype=np.uint32)
