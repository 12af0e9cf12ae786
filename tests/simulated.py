"""Tasks, and whole games of them, for the tests of the simulators."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    TourRunner,
)

MAZES = ("5x5", "4x4-tree", "7x7")
MARKED = Maze.from_text("+-+-+-+\n|S   G|\n+ +-+ +\n|     |\n+ +-+ +\n|    G|\n+-+-+-+")
CROWD = Task(
    maze=MAZES, num_chasers=2, num_evaders=2, num_runners=2, num_goals=3, max_steps=25, name="crowd"
)
TASKS = {
    "chase": make_task("chase", max_steps=30, min_start_distance=2),
    "chase, several mazes": make_task("chase", maze=MAZES, max_steps=30),
    "maze": make_task("maze", maze=MAZES, max_steps=30),
    "heist": make_task("heist", maze="6x6", max_steps=30, move_order="chasers_first"),
    "crowd": CROWD,
}
ARMS = {
    "kept": ReacherTask(2, tolerance=0.6, max_steps=25),
    "random": ReacherTask(1, start="random", hold=2, max_steps=20),
    "fixed": ReacherTask(5, start="fixed", tolerance=1.5, hold=3, max_steps=30),
    "eight": ReacherTask(8, tolerance=3.0, max_steps=15, max_turn=math.pi),
}


def policies_for(task: Task) -> list[Policy]:
    """Scripted agents of every kind, new ones at every call."""
    kinds: dict[str, Policy] = {
        "chaser": AStarChaser(0.1),
        "evader": AStarEvader(0.3),
        "runner": TourRunner(0.2),
    }
    policies = [kinds[role] for role in task.seat_roles]
    if task.num_runners > 1:
        policies[-1] = NearestGoalRunner(0.1)
    return policies


AnySimulator = Simulator | ReacherSimulator
Moment = dict[str, NDArray[Any]]


def simulator_of(task: Task | ReacherTask, *batch: Any, **settings: Any) -> AnySimulator:
    """A simulator of games or arms."""
    if isinstance(task, Task):
        return Simulator(task, *batch, **settings)
    return ReacherSimulator(task, *batch, **settings)


def snapshot(simulator: AnySimulator) -> Moment:
    """Copies of all that can be read, one row per game."""
    names = ("rewards", "terminated", "truncated", "ended", "episode_returns", "episode_lengths")
    read = {name: getattr(simulator, name).copy() for name in names}
    seen = {"seen": simulator.observe(), "final": simulator.observe_final()}
    return vars(simulator.get_state()) | read | seen


def play(simulator: AnySimulator, steps: int) -> list[Moment]:
    """What every step led to, with scripted agents in all seats; arms draw their actions."""
    policies = policies_for(simulator.task) if isinstance(simulator, Simulator) else []
    history = []
    for _ in range(steps):
        if isinstance(simulator, Simulator):
            actions = np.zeros((simulator.num_games, simulator.num_agents), dtype=np.int32)
            simulator.act(policies, actions)
            simulator.step(actions)
        else:
            simulator.step(np.clip(simulator.view().normal(), -1.0, 1.0))
        history.append(snapshot(simulator))
    return history


def assert_same(one: list[Moment], game: int, other: list[Moment], same: int) -> None:
    """Game `game` of one history is game `same` of the other, in everything."""
    for moment, counterpart in zip(one, other, strict=True):
        for name in moment:
            np.testing.assert_array_equal(moment[name][game], counterpart[name][same], name)


def assert_equal(one: Moment, other: Moment, without: Collection[str] = ()) -> None:
    """Two snapshots are equal, except for the names `without`."""
    for name in one.keys() - set(without):
        np.testing.assert_array_equal(one[name], other[name], name)


@contextmanager
def refused(simulator: AnySimulator, message: str | None = None) -> Iterator[None]:
    """A ValueError, with this message if one is given, after which nothing has changed."""
    before = snapshot(simulator)
    with pytest.raises(ValueError, match=message):
        yield
    assert_equal(snapshot(simulator), before)
