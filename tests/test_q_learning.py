"""Tabular Q-learning: its state numbers, its optimality against exact solutions, its limits."""

from __future__ import annotations

from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pursuit.maze import Maze
from pursuit.simulator import Simulator
from pursuit.task import make_task
from scripted_agents import best_response, mean_over_starts, tour_length
from train.algorithms.q_learning import QLearning, QTablePolicy, StateNumbers
from train.environment import SimulatorEnv
from train.evaluation import Contest
from train.hyperparameters import QLearningSettings
from train.run import load_policy, resume_run, start_run
from train.run_folder import load_checkpoint, new_folder
from train.settings import settings_of

# The maze of the thesis' figure 2.2 has two cells by two; goals on marks make it a fixed problem.
FIXED = Maze.from_text("+-+-+-+\n|S    |\n+ +-+ +\n|  G  |\n+ + +-+\n|    G|\n+-+-+-+\n")


def learned(task: Any, frames: int, **flat: Any) -> tuple[QLearning, QTablePolicy]:
    chosen = QLearningSettings(**flat)
    env = SimulatorEnv(Simulator(task, chosen.num_games, 0, auto_restart=False), 0, [None])
    learner = QLearning(chosen, env, 0)
    while learner.frames < frames:
        learner.iterate(learner.frames / frames)
    return learner, learner.policy()


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_different_states_have_different_numbers_and_goals_no_order(data: st.DataObject) -> None:
    goals = data.draw(st.integers(1, 3))
    task = make_task("maze", maze="3x3", num_goals=goals)
    numbers = StateNumbers(task)
    width = Simulator(task, 1).rows.shape[1]
    seen: dict[int, tuple[int, tuple[int, ...]]] = {}
    for cell in range(9):
        for count in range(goals + 1):
            for chosen in combinations(range(9), count):
                for order in permutations(chosen):
                    row = np.zeros((1, width), dtype=np.int32)
                    row[0, 0], row[0, 1] = cell, 1
                    row[0, 3 : 3 + goals] = [*order, *[-1] * (goals - count)]
                    number = int(numbers(row)[0])
                    assert 0 <= number < numbers.count
                    assert seen.setdefault(number, (cell, chosen)) == (cell, chosen)
    assert len(seen) == numbers.count


def test_captured_agents_have_numbers_of_their_own() -> None:
    task = make_task("chase", maze="2x2", num_evaders=2)
    numbers = StateNumbers(task)
    simulator = Simulator(task, 1)
    seen = set()
    for first in range(5):
        for second in range(5):
            row = np.zeros((1, simulator.rows.shape[1]), dtype=np.int32)
            row[0, :3] = 0, first % 4, second % 4
            row[0, 3:6] = 1, first < 4, second < 4
            seen.add(int(numbers(row)[0]))
    assert len(seen) == 25 and max(seen) < numbers.count


@pytest.mark.parametrize(
    ("name", "goals", "frames"), [("2x2", 1, 60_000), ("3x3", 2, 500_000), ("4x4", 1, 500_000)]
)
def test_random_goals_are_collected_by_the_shortest_tour_from_every_start(
    name: str, goals: int, frames: int
) -> None:
    task = make_task("maze", maze=name, num_goals=goals)
    _, policy = learned(task, frames)
    check_all_placements(task, policy, goals)


@pytest.mark.slow
def test_three_random_goals_on_5x5_are_collected_by_the_shortest_tour_from_every_start() -> None:
    task = make_task("maze", maze="5x5", num_goals=3)
    _, policy = learned(task, 120_000_000)
    check_all_placements(task, policy, 3)


def check_all_placements(task: Any, policy: QTablePolicy, goals: int) -> None:
    """Greedy episodes from every placement are as long as the shortest tour."""
    maze, cells = task.mazes[0], range(task.mazes[0].num_cells)
    placements = [
        (start, chosen)
        for start in cells
        for chosen in combinations(cells, goals)
        if start not in chosen
    ]
    simulator = Simulator(task, len(placements), auto_restart=False)
    simulator.place(
        np.array([[start] for start, _ in placements]), np.array([c for _, c in placements])
    )
    actions = np.zeros((len(placements), 1), dtype=np.int32)
    for _ in range(60):
        simulator.act([policy], actions)
        simulator.step(actions)
    expected = [tour_length(maze, start, chosen) for start, chosen in placements]
    assert simulator.steps.tolist() == expected


def test_fixed_goals_are_collected_by_the_shortest_tour() -> None:
    task = make_task("maze", maze=FIXED, num_goals=2, start="marks")
    _, policy = learned(task, 100_000)
    simulator = Simulator(task, 1, auto_restart=False)
    simulator.reset()
    start, goals = int(simulator.positions[0, 0]), simulator.goals[0].tolist()
    actions = np.zeros((1, 1), dtype=np.int32)
    while not simulator.ended.any():
        simulator.act([policy], actions)
        simulator.step(actions)
    assert int(simulator.steps[0]) == tour_length(FIXED, start, goals)


def test_the_values_are_those_of_value_iteration() -> None:
    maze = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n|     |\n+-+-+-+\n")
    task = make_task("maze", maze=maze, num_goals=1, max_steps=1000)
    learner, _ = learned(task, 200_000, gamma=0.9)
    numbers = learner.numbers
    for goal in range(maze.num_cells):
        values = np.zeros(maze.num_cells)
        for _ in range(100):
            after = maze.neighbors[:, :4]
            q_values = np.where(after == goal, 1.0, -0.1 + 0.9 * values[after])
            values = q_values.max(axis=1)
            values[goal] = 0.0
        rows = np.zeros((maze.num_cells, Simulator(task, 1).rows.shape[1]), dtype=np.int32)
        rows[:, 0], rows[:, 1], rows[:, 3] = np.arange(maze.num_cells), 1, goal
        own = learner.q_values[numbers(rows)]
        others = np.arange(maze.num_cells) != goal
        np.testing.assert_allclose(own[others], q_values[others], atol=1e-6)


def test_a_chaser_comes_within_a_per_cent_of_the_exact_best_response(tmp_path: Path) -> None:
    chosen = settings_of(algorithm="q_learning", maze="3x3", frames=2_000_000)
    run = start_run(chosen, tmp_path)
    run.train()
    task = chosen.task.build()
    contest = Contest(task, "chaser", chosen.task.opponents(), 100)
    score = contest.score("learned", run.policy)
    opponent = contest._opponent_table()
    best = best_response("chaser", task.mazes[0], opponent, horizon=task.max_steps)
    optimum = mean_over_starts(best.values, task.mazes[0])
    assert score.exact and optimum <= score.mean_steps < 1.01 * optimum
    again = load_policy(tmp_path)
    assert contest.score("learned", again).mean_steps == score.mean_steps


def test_it_resumes_bit_for_bit(tmp_path: Path) -> None:
    chosen = settings_of(algorithm="q_learning", maze="3x3", frames=400_000)
    whole = start_run(chosen, new_folder(tmp_path / "whole"))
    whole.train()
    halved = start_run(chosen, new_folder(tmp_path / "halved"))

    def interrupt(run: Any, row: dict[str, float]) -> None:
        run.stopped = run.stopped or run.progress > 0.5

    halved.train(interrupt)
    resume_run(tmp_path / "halved").train()
    ends = [load_checkpoint(tmp_path / name)["learner"] for name in ("whole", "halved")]
    assert ends[0]["frames"] == ends[1]["frames"]
    for name in ("q_values", "visits", "streams"):
        assert (ends[0][name] == ends[1][name]).all(), name


def test_too_many_states_and_other_games_are_refused() -> None:
    with pytest.raises(ValueError, match=r"table of [\d,]+ states.*smaller maze"):
        StateNumbers(make_task("maze", maze="9x9", num_goals=4))
    with pytest.raises(ValueError, match="one maze"):
        StateNumbers(make_task("chase", maze=("3x3", "4x4")))
    task = make_task("maze", maze="3x3", num_goals=1)
    policy = QTablePolicy(task, "runner", np.zeros((StateNumbers(task).count, 4)))
    other = Simulator(make_task("maze", maze="3x3", num_goals=2))
    other.reset()
    with pytest.raises(ValueError, match="fits no other"):
        policy.act(other.view("runner"))
    with pytest.raises(ValueError, match="none over pairs"):
        policy.action_probabilities(task.mazes[0])
