"""An exact copy of games, to be put back, elsewhere or later."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.layout import UNCHANGED, NextEpisode
from pursuit.simulator.next_episode import check_waiting, limits_of
from pursuit.tasks.task import Task

OWN = (
    "positions", "active", "events", "goals", "steps", "maze_index", "streams", "returns",
    "collected", "episode_returns", "terminated", "truncated",
)  # fmt: skip
"""The arrays of a `Simulator` that make a state, besides `epsilon` and what waits (`next_...`)."""


class SimulatorState(SimpleNamespace):
    """An exact copy of games, or of arms, random streams and pending settings included.

    Its attributes are arrays with one row a game; they are named as in the simulator, and those
    that wait for the next episode begin with `next_`. A game that is `terminated` or `truncated` is
    over and waits for a reset; no game of a simulator that restarts games by itself is.
    """


def check_arrays(state: Any, live: Mapping[str, NDArray[Any]], games: int) -> None:
    """Refuse what is no state of so many games whose own arrays are `live`.

    Raises:
        ValueError: no state, or one of another number of games or of another task.
    """
    if not isinstance(state, SimulatorState):
        raise ValueError(f"state={state!r}; give what `get_state` gave")
    for name, array in live.items():
        given, shape = np.asarray(getattr(state, name, None)), (games, *array.shape[1:])
        if given.shape != shape or given.dtype != array.dtype:
            raise ValueError(
                f"a state of other games: {name} is {given.dtype} of shape {given.shape}, and "
                f"{array.dtype} of {shape} is needed: the same task, and as many games as slots"
            )


def check_range(state: SimulatorState, name: str, least: Any, most: Any) -> None:
    """ValueError where an array of a state lies outside; NaN does not."""
    values = getattr(state, name)
    wrong = (values < least) | (values > most)
    if wrong.any():
        raise ValueError(
            f"a state of other games than these: {name} holds {values[wrong][0]}; it must come "
            "from the same task and mazes"
        )


def check_fits(
    state: SimulatorState, live: Mapping[str, NDArray[Any]], task: Task, games: int
) -> None:
    """Refuse a state that is none of so many games of `task`, whose own arrays are `live`.

    Raises:
        ValueError: the number of games, or the task, is another one, or a value that cannot be.
    """
    check_arrays(state, live, games)
    check_range(state, "maze_index", 0, len(task.mazes) - 1)
    sizes = np.array([maze.num_cells for maze in task.mazes])[state.maze_index][:, None]
    check_range(state, "positions", 0, sizes - 1)
    check_range(state, "goals", -1, sizes - 1)
    check_range(state, "active", 0, 1)
    check_range(state, "steps", 0, task.max_steps)
    check_range(state, "epsilon", 0, 1)
    for name, limits in limits_of(task).items():
        check_range(state, f"next_{name}", *limits)
    shares = state.next_epsilon
    if (((shares < 0) & (shares != UNCHANGED)) | (shares > 1)).any():
        raise ValueError("a state of other games than these: next_epsilon holds what is no share")
    waiting = (getattr(state, f"next_{name}") for name in NextEpisode._fields)
    check_waiting(task, NextEpisode(*waiting))
