"""Saved states of games, and checks before they are restored."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from pursuit.rules.arrays import Array
from pursuit.rules.layout import UNCHANGED, NextEpisode
from pursuit.simulator.next_episode import check_waiting, setting_limits
from pursuit.tasks.task import Task

OWN = (
    "positions", "active", "events", "goals", "steps", "maze_index", "streams", "returns",
    "collected", "episode_returns", "terminated", "truncated",
)  # fmt: skip
"""The arrays of a `Simulator` in a state, in addition to `exits` and `slip` in tasks with them,
`epsilon` and `next_...`."""


class SimulatorState(SimpleNamespace):
    """An exact copy of games or arms, with random streams and settings of the next episode.

    Its attributes are arrays with one row per game, named as in the simulator; settings of the next
    episode have the prefix `next_`. A `terminated` or `truncated` game waits for a reset (only in
    simulators without `auto_restart`).
    """


def check_arrays(state: object, live: Mapping[str, Array], games: int) -> None:
    """Check the shapes and dtypes of a state of `games` games; `live` are the simulator's arrays.

    Raises:
        ValueError: not a state, a different number of games, or another task.
    """
    if not isinstance(state, SimulatorState):
        raise ValueError(f"state={state!r}; give a result of `get_state`")
    for name, array in live.items():
        given, shape = np.asarray(getattr(state, name, None)), (games, *array.shape[1:])
        if given.shape != shape or given.dtype != array.dtype:
            raise ValueError(
                f"state does not match this simulator: {name} is {given.dtype} {given.shape}, "
                f"expected {array.dtype} {shape}; use the same task and number of games"
            )


def check_range(state: SimulatorState, name: str, least: Any, most: Any) -> None:
    """Raise ValueError if values of an array are out of range; NaN is accepted."""
    values = getattr(state, name)
    wrong = (values < least) | (values > most)
    if wrong.any():
        raise ValueError(
            f"state does not match this simulator: {name} contains {values[wrong][0]}; use a "
            "state of the same task and mazes"
        )


def check_values(state: SimulatorState, task: Task) -> None:
    """Raise ValueError for values that are impossible in games of `task`."""
    check_range(state, "maze_index", 0, len(task.mazes) - 1)
    sizes = np.array([maze.num_cells for maze in task.mazes])[state.maze_index][:, None]
    check_range(state, "positions", 0, sizes - 1)
    check_range(state, "goals", -1, sizes - 1)
    check_range(state, "active", 0, 1)
    check_range(state, "steps", 0, task.max_steps * task.steps_per_round)
    check_range(state, "epsilon", 0, 1)
    if task.most_exits:
        check_range(state, "exits", -1, sizes - 1)
    if task.options.slips:
        check_range(state, "slip", 0, 1)
    for name, limits in setting_limits(task).items():
        check_range(state, f"next_{name}", *limits)
    for name in ("next_epsilon", "next_slip") if task.options.slips else ("next_epsilon",):
        shares = getattr(state, name)
        if (((shares < 0) & (shares != UNCHANGED)) | (shares > 1)).any():
            raise ValueError(f"state does not match this simulator: {name} is not in [0, 1]")
    waiting = (getattr(state, f"next_{name}") for name in NextEpisode._fields)
    check_waiting(task, NextEpisode(*waiting))
