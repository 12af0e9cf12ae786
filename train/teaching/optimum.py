"""The exact optimum of the starts of a task, where it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy, TabularPolicy
from pursuit.simulator import Simulator
from pursuit.task import Task
from scripted_agents import best_response, tour_lengths
from scripted_agents.tour import MAX_EXACT_GOALS
from train.evaluation.games import MAX_EXACT_CELLS


@dataclass(frozen=True, eq=False)
class Optimum:
    """The exact optimum of any start of a task.

    Attributes:
        values: for each maze [chaser cell, evader cell], one against one; None for a lone runner.
    """

    values: tuple[NDArray[np.float64], ...] | None

    def __call__(self, simulator: Simulator, games: NDArray[np.intp]) -> NDArray[np.float64]:
        """[n] float64, steps of the best play from where `games` [n] begin."""
        steps = np.empty(len(games))
        mazes = simulator.maze_index[games]
        for number, maze in enumerate(simulator.task.mazes):
            here = games[mazes == number]
            if not len(here):
                continue
            cells = simulator.positions[here]
            found = (
                tour_lengths(maze, cells[:, 0], simulator.goals[here])
                if self.values is None
                else self.values[number][cells[:, 0], cells[:, 1]]
            )
            steps[mazes == number] = np.minimum(found, simulator.task.max_steps)
        return steps


def optimum_of(task: Task, agent: str, opponents: Mapping[str, Policy]) -> Optimum | None:
    """The exact optimum of a task; None where it is not known.

    Known for one runner alone up to MAX_EXACT_GOALS goals (beyond, tours are heuristic), and for
    one chaser against one evader whose policy is a table.

    Args:
        task: with all mazes of the training games.
        agent: who learns, by name or role.
        opponents: the policy of every other role; they stay as they are.
    """
    if (task.num_agents, task.num_runners) == (1, 1):
        return Optimum(None) if task.num_goals <= MAX_EXACT_GOALS else None
    if not task.is_duel or task.max_cells > MAX_EXACT_CELLS:
        return None
    role = task.seat_roles[task.seat(agent)]
    policy = opponents["evader" if role == "chaser" else "chaser"]
    if not isinstance(policy, TabularPolicy):
        return None
    return Optimum(
        tuple(
            best_response(
                role,  # type: ignore[arg-type]
                maze,
                policy.action_probabilities(maze, task.stay_action),
                horizon=task.max_steps,
                stay_action=task.stay_action,
                move_order=task.move_order,  # type: ignore[arg-type]
            ).values
            for maze in task.mazes
        )
    )
