"""SimulatorState: an exact copy of games, to be put back, elsewhere or later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pursuit.task import Task


@dataclass(frozen=True)
class SimulatorState:
    """An exact copy of games, random streams and pending settings included.

    Every array has one row a game; they are named as in `Simulator` and, from `next_maze` on, as in
    `Simulator.configure`.
    """

    positions: NDArray[np.int32]
    active: NDArray[np.int32]
    events: NDArray[np.int32]
    goals: NDArray[np.int32]
    steps: NDArray[np.int32]
    maze_index: NDArray[np.int32]
    streams: NDArray[np.uint64]
    epsilon: NDArray[np.float64]
    returns: NDArray[np.float64]
    episode_returns: NDArray[np.float64]
    next_maze: NDArray[np.int32]
    next_num_goals: NDArray[np.int32]
    next_goal_radius: NDArray[np.int32]
    next_goals_around_marks: NDArray[np.int32]
    next_min_start_distance: NDArray[np.int32]
    next_max_start_distance: NDArray[np.int32]
    next_epsilon: NDArray[np.float64]


def check_fits(state: SimulatorState, task: Task, num_games: int) -> None:
    """Refuse a state that is none of `num_games` games of `task`.

    Raises:
        ValueError: the number of games, or the task, is another one.
    """
    found = (len(state.steps), state.positions.shape[1], state.goals.shape[1])
    needed = (num_games, task.num_agents, task.num_goals)
    if found != needed:
        raise ValueError(
            f"a state of (games, agents, goals) = {found}; {needed} is needed: the same task, "
            "and as many games as slots"
        )
    sizes = np.array([maze.num_cells for maze in task.mazes])
    cells = np.concatenate([state.positions, state.goals], axis=1)
    if (state.maze_index >= len(sizes)).any() or (cells >= sizes[state.maze_index][:, None]).any():
        raise ValueError("a state of other mazes than these; it must come from the same task")
