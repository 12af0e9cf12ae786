"""Encodings: each lies in its space and equals a plain construction from the state."""

from __future__ import annotations

import numpy as np
import pytest

from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from tests.reference_observations import check_observations

HOLES = Maze.from_text(
    "+-+-+-+-+\n|   |   |\n+ +-+ + +\n| |#|   |\n+ +-+ + +\n|       |\n+-+-+-+-+"
)
TASKS = {
    "1v1": make_task("chase", maze="3x3", max_steps=20),
    "2v3": Task(maze=HOLES, num_chasers=2, num_evaders=3, max_steps=20),
    "maze": Task(maze=HOLES, num_runners=1, num_goals=4, max_steps=20),
    "race": Task(maze="3x3", num_runners=3, num_goals=3, max_steps=20),
    "heist": Task(maze="3x3", num_chasers=1, num_evaders=2, num_goals=2, max_steps=20),
    "escape": Task(maze=HOLES, num_chasers=1, num_evaders=2, num_exits=3, max_steps=20),
    "escape, limited sight": Task(
        maze="4x4-tree", num_chasers=1, num_evaders=1, num_exits=2, view_radius={"evader": 1}
    ),
    "all, in two mazes": Task(
        maze=("5x5", HOLES), num_chasers=2, num_evaders=2, num_runners=2, num_goals=2, max_steps=20
    ),
}


@pytest.mark.parametrize("name", TASKS)
def test_observations_are_those_of_the_plain_construction(name: str) -> None:
    _, gone, collected = check_observations(TASKS[name], seed=2, games=8, steps=30)
    assert gone > 0  # captures or collected goals were among them
    assert collected > 0 or not TASKS[name].num_goals


def played(task: Task) -> Simulator:
    """A simulator after random play."""
    simulator, rng = Simulator(task, 24, seed=1), np.random.default_rng(2)
    for _ in range(40):
        simulator.step(rng.integers(task.num_actions, size=(24, task.num_agents)))
    return simulator


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_one_agent_and_given_arrays_have_the_same_observations(encoding: str) -> None:
    simulator = played(TASKS["all, in two mazes"])
    every = simulator.observe(encoding)
    for seat, name in enumerate(simulator.task.agent_names):
        np.testing.assert_array_equal(simulator.observe(encoding, seat), every[:, seat])
        np.testing.assert_array_equal(simulator.observe(encoding, name), every[:, seat])
    out = np.full_like(every, 1)
    assert simulator.observe(encoding, out=out) is out
    np.testing.assert_array_equal(out, every)
    out = np.full_like(every, 1)
    for seat in range(simulator.num_agents):
        simulator.observe(encoding, seat, out=out[:, seat])  # not contiguous
    np.testing.assert_array_equal(out, every)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_array_that_does_not_fit_is_refused(encoding: str) -> None:
    simulator = played(TASKS["race"])
    every = simulator.observe(encoding)
    for out in (every[1:], every[..., :-1], every.astype(np.float64)):
        with pytest.raises(ValueError, match="out of shape"):
            simulator.observe(encoding, out=out.copy())


def test_an_unknown_encoding_is_named() -> None:
    with pytest.raises(ValueError, match=r"unknown observation 'onehot' .*; one of one_hot"):
        Simulator(TASKS["1v1"]).observe("onehot")
