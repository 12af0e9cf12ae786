"""Policies with memory: every episode starts with empty memory in all batches."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit import Simulator, chase_v0, make_task
from pursuit.simulator.policy import GameView, Memory, MemoryPolicy, play
from scripted_agents import AStarChaser, AStarEvader


class Counter:
    """Counts the steps of every episode in memory, and compares them with the game."""

    def __init__(self) -> None:
        self.memory = Memory(lambda view: {"steps": np.full(view.num_games, -1)})

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        self.memory.of(view)["steps"][view.rows[games]] = 0

    def act(self, view: GameView) -> NDArray[np.int32]:
        counted = self.memory.of(view)["steps"]
        assert (counted[view.rows] == view.steps).all()
        counted[view.rows] += 1
        return (counted[view.rows] % view.task.num_actions).astype(np.int32)


TASK = make_task("chase", maze="3x3", max_steps=7)


def played(simulator: Simulator, policies: Any, steps: int) -> None:
    actions = np.zeros((simulator.num_games, simulator.num_agents), dtype=np.int32)
    for _ in range(steps):
        simulator.act(policies, actions)
        simulator.step(actions)


def test_one_policy_has_separate_memory_per_batch_agent_and_game() -> None:
    counter = Counter()
    assert isinstance(counter, MemoryPolicy) and not isinstance(AStarChaser(), MemoryPolicy)
    small, large = Simulator(TASK, 3, seed=1), Simulator(TASK, 50, seed=2)
    for _ in range(5):
        played(small, [counter, AStarEvader(epsilon=0.5)], 9)
        played(large, [counter, counter], 11)


def test_parts_of_a_batch_use_their_rows_of_memory() -> None:
    counter, simulator = Counter(), Simulator(TASK, 10, seed=3)
    actions = np.zeros((10, 2), dtype=np.int32)
    for _ in range(20):
        view = simulator.view("chaser")
        for half in (np.arange(0, 10, 2), np.arange(1, 10, 2)):
            part = view.select(half).select(np.arange(5)[::-1].copy())
            assert part.rows.tolist() == half[::-1].tolist()
            actions[half[::-1], 0] = play(counter, part)
        simulator.step(actions)


def test_environments_reset_memory() -> None:
    env = chase_v0.parallel_env(maze="3x3", max_steps=5)
    counter = Counter()
    for _ in range(3):
        env.reset(seed=4)
        while env.agents:
            before = env.unwrapped.simulator.steps[0]
            env.step(env.act({"chaser": counter, "evader": counter}))
            assert counter.memory.of(env.unwrapped.simulator.view("chaser"))["steps"] == before + 1


def test_a_copy_starts_with_empty_memory() -> None:
    counter, simulator = Counter(), Simulator(TASK, 4, seed=5)
    played(simulator, [counter, AStarEvader()], 2)
    copied = Memory(counter.memory._make)
    assert (copied.of(simulator.view("chaser"))["steps"] == -1).all()
    assert (copy.copy(counter.memory).of(simulator.view("chaser"))["steps"] == -1).all()
