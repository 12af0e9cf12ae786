"""The exact optimum of the starts of a task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.rules.arrays import Array
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import least_steps_of, tour_lengths
from scripted_agents.exact.limits import MAX_CURRICULUM_JOINTS
from scripted_agents.exact.references import (
    ARMS,
    TOUR,
    Question,
    is_solved_duel,
    solution_of,
)
from train.evaluation.games import best_reply, other_role, table_in


@dataclass(frozen=True, eq=False)
class Optimum:
    """The exact optimum of any start of a task.

    Starts are recorded when episodes start and solved together, which is faster than one by one.

    Attributes:
        starts: (simulator, games [n]) -> arrays [n, ...], copies: the current starts of games.
        steps: (those arrays) -> [n] float64, the optimal steps of each start.
    """

    starts: Callable[[Any, NDArray[np.intp]], tuple[Array, ...]]
    steps: Callable[..., NDArray[np.float64]]


def _maze_starts(simulator: Simulator, games: NDArray[np.intp]) -> tuple[Array, ...]:
    """The maze indices [n], and the cells of agents and goals [n, ...], of games."""
    return simulator.maze_index[games], simulator.positions[games], simulator.goals[games]


def _optimum(task: Task, steps: Callable[..., Array]) -> Optimum:
    """The optimum by `steps`: (maze index, maze, cells of agents, cells of goals) -> [n]."""

    def all_steps(mazes: Array, cells: Array, goals: Array) -> NDArray[np.float64]:
        found = np.empty(len(mazes))
        for number, maze in enumerate(task.mazes):
            here = mazes == number
            if here.any():
                found[here] = steps(number, maze, cells[here], goals[here])
        return np.minimum(found, task.max_steps)

    return Optimum(_maze_starts, all_steps)


def optimum_of(task: Task, agent: str, opponents: Mapping[str, Policy]) -> Optimum | None:
    """The exact optimum of a task; None if unknown.

    It is known for a single runner with up to MAX_EXACT_GOALS goals, and for duels in which the
    opponent's policy is a table, with full view.

    Args:
        task: with all mazes of the training games.
        agent: the learning agent, by name or role.
        opponents: the fixed policy of every other role.
    """
    if TOUR.why_not(Question(task, None, {})) is None:
        return _optimum(
            task, lambda number, maze, cells, goals: tour_lengths(maze, cells[:, 0], goals)
        )
    role = task.seat_roles[task.seat(agent)]
    policy = opponents.get(other_role(role))
    if not is_solved_duel(task, policy):
        return None
    tables = [
        best_reply(task, role, table_in(task, policy, maze), task.max_steps, maze=maze).values
        for maze in task.mazes
    ]
    return _optimum(task, lambda number, maze, cells, goals: tables[number][tuple(cells.T)])


def arm_optimum(task: ReacherTask) -> Optimum | None:
    """The minimum steps of an arm; None for many joints, and for discrete actions."""
    if (
        task.joints > MAX_CURRICULUM_JOINTS
        or solution_of(Question(task, "arm", {}), ARMS).kind != "arm"
    ):
        return None

    def steps(
        angles: Array, target: Array, tolerance: Array, free_joints: Array, hold: Array
    ) -> NDArray[np.float64]:
        least, _, _ = least_steps_of(angles, target, task.max_turn, tolerance, free_joints)
        lengths: NDArray[np.float64] = np.maximum(least, 1.0) + hold - 1.0
        return np.minimum(lengths, task.max_steps)

    return Optimum(_arm_starts, steps)


def _arm_starts(simulator: ReacherSimulator, games: NDArray[np.intp]) -> tuple[Array, ...]:
    """The arrays that determine the least length of an episode of `games`."""
    arms = simulator.arms
    start = (arms.angles, arms.target, arms.tolerance, arms.free_joints, arms.hold)
    return tuple(array[games] for array in start)
