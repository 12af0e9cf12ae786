"""Tasks, and whole games of them, for the tests of the simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
from game_rows import rows_of
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
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


def play(simulator: Simulator, steps: int) -> list[list[NDArray[Any]]]:
    """What every step led to, with scripted agents in all seats."""
    policies = policies_for(simulator.task)
    actions = np.zeros((simulator.num_games, simulator.num_agents), dtype=np.int32)
    history = []
    for _ in range(steps):
        simulator.act(policies, actions)
        simulator.step(actions)
        parts = (rows_of(simulator), simulator.rewards, simulator.returns, simulator.ended)
        history.append([part.copy() for part in (actions, *parts)])
    return history


def assert_same(
    one: list[list[NDArray[Any]]], game: int, other: list[list[NDArray[Any]]], same: int
) -> None:
    """Game `game` of one history is game `same` of the other, in everything."""
    for parts, others in zip(one, other, strict=True):
        for part, counterpart in zip(parts, others, strict=True):
            np.testing.assert_array_equal(part[game], counterpart[same])
