"""The optimal policy of agents in mazes that plays all equally good actions of a state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks, task_has_masks
from pursuit.rules.layout import FIRST_CELL, Games
from pursuit.simulator.policy import GameView, Policy
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents import action_values
from scripted_agents.exact.joint.policy import drawn
from train.evaluation.games import duel_role, order_of
from train.evaluation.suite_tables import tables_of

OptimalActions = Callable[[Task, Games, int], NDArray[Any]]
"""(task, games, seat) -> [games, actions], above 0 for optimal actions; of those with which the
agent stays in its cell one is enough, and in games that are over there may be none."""


class OptimalPolicy:
    """Plays all equally good actions of a state with the same probability.

    Moves into walls and stay are equally good. Where the agents have action masks, actions that are
    masked are not played; they have the effect of stay. Agents that have left the game, and those
    of games that are over, play any action.

    Args:
        optimal: the optimal actions.
        task: the game.
        seats: the indices of the agents.
        mask_bumps: whether the agents have masks (in turns they always do); but for runners alone
            with the stay action, as waiting may be optimal.
    """

    def __init__(
        self, optimal: OptimalActions, task: Task, seats: tuple[int, ...], mask_bumps: bool
    ) -> None:
        self.optimal, self.task, self.seats, self.mask_bumps = optimal, task, seats, mask_bumps
        self.role = task.seat_roles[seats[0]]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self.task.agent_names[s] for s in self.seats)})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream."""
        rows = self.distribution(view.task, view.games, view.seat)
        return drawn(view.uniform(), rows.cumsum(axis=1)).astype(np.int32)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, the distributions in any games, also in several mazes.

        Raises:
            ValueError: another seat, or games of another task.
        """
        check(seat in self.seats, f"{self!r} has no policy for {task.agent_names[seat]}")
        good, world = self.optimal(task, games, seat) > 0, lay_out(task.mazes)
        here = world.mazes[FIRST_CELL, games.maze] + games.position[:, seat]
        stays = world.neighbors[here, : task.num_actions] == games.position[:, [seat]]
        good |= stays & (good & stays).any(axis=1, keepdims=True)
        allowed = np.ones_like(good)
        if task_has_masks(task, self.mask_bumps):
            allowed = action_masks(games, world, task, slice(seat, seat + 1))[:, 0]
            if task.stay_action:
                good[:, -1] |= (good & ~allowed).any(axis=1)
        good &= allowed
        good |= allowed & ~good.any(axis=1, keepdims=True)
        return good / good.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class DuelActions:
    """`OptimalActions` of a duel, solved for each maze when it first occurs.

    Attributes:
        task: the rules; its time limit is the horizon.
        seat: the index of the agent.
        opponent: known as a table in each maze (`tables_of`).
    """

    task: Task
    seat: int
    opponent: Policy
    _solved: dict[Maze, NDArray[np.bool_]] = field(default_factory=dict, init=False, repr=False)

    def in_games(self, task: Task, games: Games, seat: int) -> NDArray[np.bool_]:
        """[games, actions] bool, the optimal actions of the first step; none where both are in one
        cell."""
        found = np.zeros((len(games.steps), task.num_actions), dtype=bool)
        for number in np.unique(games.maze).tolist():
            maze, here = task.mazes[number], games.maze == number
            if maze not in self._solved:
                self._solved[maze] = self._solve(replace(self.task, maze=maze))
            cells = games.position[here]
            found[here] = self._solved[maze][cells[:, seat], cells[:, 1 - seat]]
        return found

    def _solve(self, task: Task) -> NDArray[np.bool_]:
        """[own cell, other cell, action] bool, in the only maze of a task."""
        (table,) = tables_of(self.opponent, task, 1 - self.seat)
        role = duel_role(task.seat_roles[self.seat])
        rules = (task.max_steps, task.stay_action, order_of(task))
        return action_values(role, task.mazes[0], table, *rules).optimal
