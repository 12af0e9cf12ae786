"""The agent that draws from all actions, by closed forms and by counting."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from pursuit.mazes.maze import Maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, UniformAgent, evaluate_exactly, evaluate_joint
from scripted_agents.environments import scripted_policy
from scripted_agents.names import AGENTS

CORRIDOR = Maze.from_text("+-+-+-+\n|     |\n+-+-+-+")


@pytest.mark.parametrize(("maze", "stay"), [("3x3", False), ("roads-8x8", True)])
def test_every_action_is_drawn_equally_often(maze: str, stay: bool) -> None:
    task = make_task("chase", maze=maze, stay_action=stay)
    simulator = Simulator(task, 20_000, seed=3)
    actions = np.zeros((20_000, 2), dtype=np.int32)
    agent = UniformAgent()
    simulator.act([None, agent], actions)
    share = np.bincount(actions[:, 1], minlength=task.num_actions) / len(actions)
    np.testing.assert_allclose(share, 1 / task.num_actions, atol=0.015)
    rows = agent.distribution(task, simulator.games, 1)
    np.testing.assert_allclose(rows, 1 / task.num_actions, rtol=1e-12)


@pytest.mark.parametrize("stay", [False, True])
def test_the_exact_steps_in_a_corridor_are_those_of_the_closed_form(stay: bool) -> None:
    """From the ends of three cells the chaser needs one step if the evader comes towards it, which
    is one of its actions; else two."""
    task = Task(CORRIDOR, num_chasers=1, num_evaders=1, stay_action=stay)
    expected = 2.0 - 1.0 / task.num_actions
    chaser, evader = AStarChaser(), UniformAgent()
    tables = [agent.action_probabilities(CORRIDOR, stay) for agent in (chaser, evader)]
    assert evaluate_exactly(CORRIDOR, *tables, horizon=200)[0, 2] == pytest.approx(expected)
    simulator = Simulator(task, 20_000, seed=4)
    simulator.place([0, 2])
    actions = np.zeros((20_000, 2), dtype=np.int32)
    captured = np.zeros(20_000, dtype=bool)
    for _ in range(2):
        simulator.act([chaser, evader], actions)
        simulator.step(actions)
        captured |= simulator.terminated
        assert captured.mean() == pytest.approx(1.0 if captured.all() else 2 - expected, abs=0.015)
    assert captured.all()


def test_joint_solutions_know_it() -> None:
    """Two chasers at one end, one of which has to reach the evader: as one alone."""
    task = Task(CORRIDOR, num_chasers=2, num_evaders=1, stay_action=True)
    values = evaluate_joint(task, {"chaser": AStarChaser(), "evader": UniformAgent()})
    simulator = Simulator(task)
    simulator.positions[:] = [0, 0, 2]
    (state,) = values.states.numbers(simulator.games)
    assert values.values["length"][state] == pytest.approx(1.8)


def test_it_is_an_opponent_by_name() -> None:
    assert "uniform" in AGENTS
    assert isinstance(scripted_policy("uniform", "evader"), UniformAgent)
    settings = {"maze": CORRIDOR, "observation": "positions", "opponent": "uniform"}
    envs = gymnasium.make_vec("pursuit/Chaser-v0", num_envs=1000, **settings)
    before, _ = envs.reset(seed=0)
    after, *_ = envs.step(np.zeros(1000, dtype=int))
    ends = before[:, 1] != 2  # cells are numbered from 1: one of four moves leads from an end
    assert (before[ends, 1] == after[ends, 1]).mean() == pytest.approx(0.75, abs=0.05)
