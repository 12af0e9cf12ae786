"""Scripted agents over whole games: tours, and the exact values of what they play."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from random_mazes import connected_maze

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import load_maze
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    TablePolicy,
    TourRunner,
    best_response,
    evaluate_exactly,
    mean_over_starts,
    tour_length,
    tour_lengths,
)

# -- tours -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("tables", [True, False])
@pytest.mark.parametrize("num_goals", range(1, 7))
def test_tour_runners_need_exactly_the_length_of_the_tour(
    num_goals: int, tables: bool, without_tables: Callable[[], None]
) -> None:
    maze = generate_maze("wilson", 7, 8, loops=0.3, seed=num_goals)
    games = 400 if tables else 15
    if not tables:
        without_tables()
    task = Task(maze=maze, num_runners=1, num_goals=num_goals, max_steps=1000)
    simulator = Simulator(task, games, seed=1, auto_restart=False)
    lengths = tour_lengths(maze, simulator.positions[:, 0], simulator.goals)
    runner, actions = TourRunner(), np.zeros((games, 1), dtype=np.int32)
    for _ in range(lengths.max()):
        simulator.act([runner], actions)
        simulator.step(actions)
    assert simulator.terminated.all()
    np.testing.assert_array_equal(simulator.steps, lengths)


@pytest.mark.parametrize("tables", [True, False])
def test_tour_runners_are_on_a_shortest_tour_wherever_they_were_moved(
    tables: bool, without_tables: Callable[[], None]
) -> None:
    """Pushed about at random, two runners of one agent, and taken from one maze to another."""
    mazes = [connected_maze(seed, 5, 5) for seed in (1, 2)]
    if not tables:
        without_tables()
    simulators = [
        Simulator(Task(maze=maze, num_runners=2, num_goals=3, max_steps=15), 8, seed=4)
        for maze in mazes
    ]
    runner, rng = TourRunner(), np.random.default_rng(0)
    actions = np.zeros((8, 2), dtype=np.int32)
    for turn in range(60):
        maze, simulator = mazes[turn % 2], simulators[turn % 2]
        if turn % 10 == 1:  # the same cells in the other maze
            both = [*simulators[0].positions[0], *simulators[0].goals[0]]
            if max(both) < maze.num_cells:
                simulator.place(both[:2], both[2:])
        simulator.act([runner, runner], actions)
        for game in range(8):
            left = [goal for goal in simulator.goals[game] if goal >= 0]
            for own, action in zip(simulator.positions[game], actions[game], strict=True):
                after = int(maze.neighbors[own, action])
                assert tour_length(maze, after, left) == tour_length(maze, int(own), left) - 1
        simulator.step(rng.integers(4, size=(8, 2)))


def test_what_a_tour_runner_does_depends_on_the_state_alone() -> None:
    simulator = Simulator(Task(maze="7x7", num_runners=1, num_goals=5, max_steps=40), 64, seed=2)
    runner, rng = TourRunner(), np.random.default_rng(0)
    actions, others = (np.zeros((64, 1), dtype=np.int32) for _ in range(2))
    simulator.reset()
    for _ in range(150):
        state = simulator.get_state()
        simulator.act([runner], actions)
        simulator.set_state(state)
        simulator.act([TourRunner()], others)
        np.testing.assert_array_equal(actions, others)
        pushed = rng.random(64) < 0.3
        actions[pushed] = rng.integers(4, size=(pushed.sum(), 1))
        simulator.step(actions)


# -- exact values ----------------------------------------------------------------------------------

LIBRARY_MAZE = load_maze("5x5")


@cache
def pairings() -> dict[str, tuple[Policy, Policy]]:
    chaser, evader = AStarChaser(0.1), AStarEvader(0.2)
    chaser_table = chaser.action_probabilities(LIBRARY_MAZE)
    evader_table = evader.action_probabilities(LIBRARY_MAZE)
    best_chaser = best_response("chaser", LIBRARY_MAZE, evader_table, horizon=None)
    best_evader = best_response("evader", LIBRARY_MAZE, chaser_table)
    return {
        "A* against A*": (chaser, evader),
        "best chaser against A*": (TablePolicy(LIBRARY_MAZE, best_chaser.policy), evader),
        "A* against best evader": (chaser, TablePolicy(LIBRARY_MAZE, best_evader.policy)),
    }


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("A* against A*", "simultaneous"),
        ("best chaser against A*", "simultaneous"),
        ("A* against best evader", "simultaneous"),
        pytest.param("A* against A*", "chasers_first", marks=pytest.mark.slow),
    ],
)
def test_simulated_games_last_as_long_as_computed(name: str, order: Any) -> None:
    policies: Any = pairings()[name]
    tables = [policy.action_probabilities(LIBRARY_MAZE) for policy in policies]
    values = evaluate_exactly(LIBRARY_MAZE, *tables, move_order=order)
    games = 50_000
    task = make_task("chase", maze=LIBRARY_MAZE, move_order=order)
    simulator = Simulator(task, games, seed=1, auto_restart=False)
    actions = np.zeros((games, 2), dtype=np.int32)
    while not simulator.ended.all():
        simulator.act(policies, actions)
        simulator.step(actions)
    error = 3.29 * simulator.steps.std() / np.sqrt(games)  # 99.9 %
    expected = mean_over_starts(values, LIBRARY_MAZE)
    assert abs(simulator.steps.mean() - expected) <= error + 1e-9 * expected


def test_the_best_chaser_is_faster_than_a_star_and_the_best_evader_lasts_longer() -> None:
    means = {
        name: mean_over_starts(
            evaluate_exactly(
                LIBRARY_MAZE, *[policy.action_probabilities(LIBRARY_MAZE) for policy in policies]
            ),
            LIBRARY_MAZE,
        )
        for name, policies in pairings().items()
    }
    best_chaser, a_star, best_evader = (
        means[name]
        for name in ("best chaser against A*", "A* against A*", "A* against best evader")
    )
    assert best_chaser < a_star < best_evader
