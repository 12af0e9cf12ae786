"""SimulatorState: an exact copy of games, to be put back, elsewhere or later."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules import layout
from pursuit.rules.layout import UNCHANGED, NextEpisode
from pursuit.simulator.next_episode import check_waiting, limits_of
from pursuit.tasks.task import Task


@dataclass(frozen=True)
class SimulatorState:
    """An exact copy of games, random streams and pending settings included.

    Every array has one row a game; they are named as in `Simulator` and, from `next_maze` on, as in
    `Simulator.configure`. A game that is `terminated` or `truncated` is over and waits for a reset;
    no game of a simulator that restarts games by itself is.
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
    collected: NDArray[np.float64]
    episode_returns: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    next_maze: NDArray[np.int32]
    next_num_goals: NDArray[np.int32]
    next_goal_radius: NDArray[np.int32]
    next_goals_around_marks: NDArray[np.int32]
    next_min_start_distance: NDArray[np.int32]
    next_max_start_distance: NDArray[np.int32]
    next_epsilon: NDArray[np.float64]


def live_state(simulator: Any, epsilon: NDArray[np.float64], coming: NextEpisode) -> SimulatorState:
    """All that makes the games of a simulator: its own arrays, not copies."""
    waiting = {f"next_{name}": array for name, array in coming._asdict().items()}
    names = [field.name for field in fields(SimulatorState) if field.name not in waiting]
    own = {name: getattr(simulator, name) for name in names}
    return SimulatorState(**{**own, "epsilon": epsilon}, **waiting)


def check_fits(state: SimulatorState, live: SimulatorState, task: Task, games: int) -> None:
    """Refuse a state that is none of so many games of `task`, whose own are `live`.

    Raises:
        ValueError: the number of games, or the task, is another one, or a value that cannot be.
    """
    if not isinstance(state, SimulatorState):
        raise ValueError(f"state={state!r}; give what `get_state` gave")
    for name, array in vars(live).items():
        given = np.asarray(getattr(state, name))
        if given.shape != (games, *array.shape[1:]) or given.dtype != array.dtype:
            raise ValueError(
                f"a state of other games: {name} is {given.dtype} of shape {given.shape}, and "
                f"{array.dtype} of {(games, *array.shape[1:])} is needed: the same task, and as "
                "many games as slots"
            )
    _check_range("maze_index", state.maze_index, 0, len(task.mazes) - 1)
    sizes = np.array([maze.num_cells for maze in task.mazes])[state.maze_index][:, None]
    _check_range("positions", state.positions, 0, sizes - 1)
    _check_range("goals", state.goals, -1, sizes - 1)
    _check_range("active", state.active, 0, 1)
    _check_range("steps", state.steps, 0, task.max_steps)
    _check_range("epsilon", state.epsilon, 0, 1)
    waiting = waiting_in(state)
    for name, (least, most) in limits_of(task).items():
        _check_range(f"next_{name}", getattr(waiting, name), least, most)
    shares = waiting.epsilon[waiting.epsilon != UNCHANGED]
    _check_range("next_epsilon", shares, 0, 1)
    check_waiting(task, waiting)


def waiting_in(state: SimulatorState) -> NextEpisode:
    """The settings that wait for the next episode."""
    return NextEpisode(*(getattr(state, f"next_{name}") for name in NextEpisode._fields))


def _check_range(name: str, values: NDArray[Any], least: Any, most: Any) -> None:
    """Refuse what lies outside; NaN does not."""
    wrong = (values < least) | (values > most)
    if wrong.any():
        raise ValueError(
            f"a state of other games than these: {name} holds {values[wrong][0]}; it must come "
            "from the same task and mazes"
        )


def arrays_of(outcome: layout.Outcome) -> list[NDArray[Any]]:
    """All that steps write beside the games."""
    return [*outcome.final, *(part for part in outcome if isinstance(part, np.ndarray))]


def bytes_of_game(task: Task) -> int:
    """The memory that one game of a simulator takes."""
    return sum(array.nbytes for array in layout.allocate(1, task.num_agents, task.num_goals))
