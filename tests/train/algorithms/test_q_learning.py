"""Tabular Q-learning: its state numbers, its optimality against exact solutions, its limits."""

from __future__ import annotations

from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from game_rows import rows_of
from hypothesis import given, settings
from hypothesis import strategies as st

from pursuit.environments.single_agent import fill_seats
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import Encoder
from pursuit.rules import Games
from pursuit.rules.layout import empty_games
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import best_response, mean_over_starts, tour_length
from scripted_agents.environments import default_policies
from train.algorithms.learner import Build
from train.algorithms.q_learning import (
    STEPS_PER_ITERATION,
    QLearning,
    choose_actions,
    learn,
)
from train.environments.simulator_env import SimulatorEnv
from train.kinds import start
from train.networks.numbering import QTablePolicy, StateNumbers
from train.networks.policy import MazeSeat
from train.runs.folder import RUN
from train.runs.opponents import load_policy
from train.runs.parts import contest_of, settings_of
from train.settings.algorithms import QLearningSettings

# The maze of the thesis' figure 2.2 has two cells by two; goals on marks make it a fixed problem.
FIXED = Maze.from_text("+-+-+-+\n|S    |\n+ +-+ +\n|  G  |\n+ + +-+\n|    G|\n+-+-+-+\n")


def learned(task: Any, frames: int, **flat: Any) -> tuple[QLearning, QTablePolicy]:
    chosen = QLearningSettings(**{"num_games": 256, **flat})
    simulator = Simulator(task, chosen.num_games, 0, auto_restart=False)
    env = SimulatorEnv(simulator, MazeSeat(task, "runner"), [None])
    learner = QLearning(chosen, env, Build())
    while learner.frames < frames:
        learner.iterate(learner.frames / frames)
    return learner, learner.policy()


def games_of(task: Task, cells: Any, goals: Any = ()) -> Games:
    """Games with all agents active in these cells [games, agents], and these goals."""
    games = empty_games(len(cells), task.num_agents, task.num_goals)
    games.position[:], games.active[:] = cells, 1
    games.goal[:] = goals if task.num_goals else games.goal
    return games


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_different_states_have_different_numbers_and_goals_no_order(data: st.DataObject) -> None:
    goals = data.draw(st.integers(1, 3))
    task = make_task("maze", maze="3x3", num_goals=goals)
    numbers = StateNumbers(task)
    seen: dict[int, tuple[int, tuple[int, ...]]] = {}
    for cell in range(9):
        for count in range(goals + 1):
            for chosen in combinations(range(9), count):
                for order in permutations(chosen):
                    left = [*order, *[-1] * (goals - count)]
                    number = int(numbers(games_of(task, [[cell]], [left]))[0])
                    assert 0 <= number < numbers.count
                    assert seen.setdefault(number, (cell, chosen)) == (cell, chosen)
    assert len(seen) == numbers.count


def test_captured_agents_have_numbers_of_their_own() -> None:
    task = make_task("chase", maze="2x2", num_evaders=2)
    numbers = StateNumbers(task)
    seen = set()
    for first in range(5):
        for second in range(5):
            games = games_of(task, [[0, first % 4, second % 4]])
            games.active[:] = [1, first < 4, second < 4]
            seen.add(int(numbers(games)[0]))
    assert len(seen) == 25 and max(seen) < numbers.count


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("maze", {"num_goals": 3}),
        ("race", {"num_runners": 2, "num_goals": 2}),
        ("chase", {"num_chasers": 2, "num_evaders": 2}),
        ("heist", {"num_evaders": 2, "num_goals": 1}),
    ],
)
def test_observations_have_the_numbers_of_their_states(name: str, changed: Any) -> None:
    task = make_task(name, maze="3x3", **changed)
    rng, count = np.random.default_rng(0), 500
    goals = np.array([rng.permutation(9)[: task.num_goals] for _ in range(count)])
    goals = np.where(rng.random(goals.shape) < 0.4, -1, goals)
    games = games_of(task, rng.integers(0, 9, (count, task.num_agents)), goals)
    if len(task.agent_names) > 2:
        games.active[:] = rng.integers(0, 2, games.active.shape)
    for agent in task.agent_names:
        numbers, seat = StateNumbers(task, agent), task.seat(agent)
        seen = Encoder(task, "index").encode(games)[:, seat]
        found = numbers.of_index(torch.from_numpy(seen)).numpy()
        np.testing.assert_array_equal(found, numbers(games))


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
    _, policy = learned(task, 30_000_000, num_games=1024)
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
    start, goals = int(simulator.positions[0, 0]), simulator.goals[0].tolist()
    actions = np.zeros((1, 1), dtype=np.int32)
    while not simulator.ended.any():
        simulator.act([policy], actions)
        simulator.step(actions)
    assert int(simulator.steps[0]) == tour_length(FIXED, start, goals)


def test_the_values_are_those_of_value_iteration() -> None:
    maze = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n|     |\n+-+-+-+\n")
    task = make_task("maze", maze=maze, num_goals=1, max_steps=1000)
    learner, _ = learned(task, 200_000, gamma=0.9, epsilon_start=1.0, epsilon_end=1.0)
    numbers = learner.numbers
    for goal in range(maze.num_cells):
        values = np.zeros(maze.num_cells)
        for _ in range(100):
            after = maze.neighbors[:, :4]
            q_values = np.where(after == goal, 1.0, -0.1 + 0.9 * values[after])
            values = q_values.max(axis=1)
            values[goal] = 0.0
        games = games_of(task, np.arange(maze.num_cells)[:, None], goal)
        own = learner.q_values[numbers(games)]
        others = np.arange(maze.num_cells) != goal
        np.testing.assert_allclose(own[others], q_values[others], atol=1e-6)


def test_optimistic_values_fall_and_never_below_the_optimal_values() -> None:
    task = make_task("maze", maze="3x3", num_goals=1)
    maze = task.mazes[0]
    learner, _ = learned(task, 0)
    cell, goal = np.divmod(np.arange(81), 9)
    states = learner.numbers(games_of(task, cell[:, None], goal[:, None]))
    left = maze.distances[maze.neighbors[cell, :4], goal[:, None]].astype(float)
    truth = np.where(left == 0, 1.0, -0.1 + 1.0 - 0.1 * (left - 1))[cell != goal]
    before = learner.q_values[states]
    assert (before == 1.0).all()  # one goal is left in each
    for _ in range(6):
        learner.iterate(0.0)
        after = learner.q_values[states]
        assert (after <= before).all() and (
            after[cell != goal] >= truth - 1e-6
        ).all()  # float32 rewards
        before = after.copy()
    np.testing.assert_allclose(before[cell != goal].max(axis=1), truth.max(axis=1), atol=1e-6)


@pytest.mark.parametrize(("agent", "evaders"), [("chaser_0", 1), ("evader_0", 2)])
def test_episodes_end_as_those_of_the_environment_do(agent: str, evaders: int) -> None:
    task = make_task("chase", maze="3x3", num_evaders=evaders, max_steps=12)
    seat, policies = fill_seats(task, agent, default_policies(task, 0.2))
    own, other = (
        SimulatorEnv(Simulator(task, 32, 5, auto_restart=False), MazeSeat(task, agent), policies)
        for _ in range(2)
    )
    # Actions at random depend on the learner's streams alone.
    chosen = QLearningSettings(num_games=32, epsilon_start=1.0, epsilon_end=1.0)
    learner = QLearning(chosen, own, Build(seed=7))
    streams = learner._streams.copy()
    learner.iterate(0.0)
    actions, now = np.zeros((32, task.num_agents), dtype=np.int32), other.reset()
    for _ in range(STEPS_PER_ITERATION):
        zeros = np.zeros(32, dtype=np.int64)
        cells, every = np.zeros((32, task.num_agents), dtype=np.int32), np.ones((1, 4), dtype=bool)
        choose_actions(np.zeros((1, 4)), zeros, cells, every, streams, 1.0, actions, seat)
        now["action"] = torch.from_numpy(actions[:, seat].astype(np.int64))
        _, now = other.step_and_maybe_reset(now)
    for name in ("finished_returns", "finished_lengths"):
        mine, theirs = (np.concatenate(getattr(env, name)) for env in (own, other))
        np.testing.assert_array_equal(mine, theirs)
    assert (rows_of(own.simulator) == rows_of(other.simulator)).all()
    lengths = np.concatenate(own.finished_lengths)
    assert (lengths == 12).any() and (lengths < 12).any()


@pytest.mark.parametrize("kind", ["terminated", "truncated", "captured"])
def test_only_truncation_is_bootstrapped_and_steps_shrink_with_visits(kind: str) -> None:
    task = make_task("chase", maze="2x2", num_evaders=2)
    numbers = StateNumbers(task)
    games = games_of(task, [[0, 1, 2]])
    games.active[:] = [1, kind != "captured", 1]
    q_values, visits = np.full((numbers.count, 4), 5.0), np.zeros((numbers.count, 4), np.uint32)
    before = int(numbers(games)[0]) ^ 1
    ended = (np.array([kind == "terminated"]), np.array([kind == "truncated"]))
    done = np.zeros(1, dtype=bool)
    target, expected = 2.0 + (0.5 * 5.0 if kind == "truncated" else 0.0), 5.0
    every = np.ones((4, 4), dtype=bool)
    for visit in (1, 2, 3):
        learn(
            q_values, visits, *games, numbers.for_kernels, every, np.array([before]),
            np.array([[0, 3, 0]], dtype=np.int32), 1, np.array([[0, 2, 0]], dtype=np.float32),
            *ended, done, 0.5, 0.8, 0.7,
        )  # fmt: skip
        expected += 0.8 / visit**0.7 * (target - expected)
        assert q_values[before, 3] == pytest.approx(expected) and done.all()
    assert visits.sum() == visits[before, 3] == 3
    assert (np.delete(q_values.ravel(), 4 * before + 3) == 5.0).all()


@pytest.mark.parametrize(
    ("maze", "frames"),
    [("3x3", 2_000_000), pytest.param("5x5", 30_000_000, marks=pytest.mark.slow)],
)
def test_a_chaser_comes_within_a_per_cent_of_the_exact_best_response(
    maze: str, frames: int, tmp_path: Path
) -> None:
    chosen = settings_of(algorithm="q_learning", maze=maze, frames=frames)
    run = start(RUN, chosen, tmp_path)
    run.train()
    contest = contest_of(chosen.task, 100)
    task = contest.task
    score = contest.score("learned", run.trainee.policy)
    opponent = contest.opponent_table()
    best = best_response("chaser", task.mazes[0], opponent, horizon=task.max_steps)
    optimum = mean_over_starts(best.values, task.mazes[0])
    assert score.exact and optimum <= score.mean_steps < 1.01 * optimum
    again = load_policy(tmp_path)
    assert contest.score("learned", again).mean_steps == score.mean_steps


def test_exploration_is_independent_of_the_starts() -> None:
    """Its numbers are of a stream of its own: none of those of the games, whatever the learner."""
    task = make_task("chase", maze="3x3")
    simulator = Simulator(task, 64, 7, auto_restart=False)
    simulator.seed(7)
    _, policies = fill_seats(task, "chaser_0", default_policies(task, 0.2))
    env = SimulatorEnv(simulator, MazeSeat(task, "chaser_0"), policies)
    streams = QLearning(QLearningSettings(num_games=64), env, Build(seed=7))._streams
    assert streams.shape == (64, 1) and len(np.unique(streams)) == 64
    assert not np.isin(streams, simulator.streams).any()


def test_a_positive_reward_at_every_step_needs_a_discount() -> None:
    evader = {"algorithm": "q_learning", "role": "evader", "maze": "3x3", "frames": 1}
    assert settings_of(**evader).hyper.gamma == 0.95
    for rewards in ("default", "zero_sum", "distance"):
        with pytest.raises(ValueError, match="makes values unbounded"):
            settings_of(**evader, rewards=rewards, gamma=1.0)
    for other in ({"role": "chaser"}, {"task": "heist"}):  # these hurry, so every value is bounded
        settings_of(**{**evader, **other}, gamma=1.0)


def test_too_many_states_and_other_games_are_refused() -> None:
    with pytest.raises(ValueError, match=r"table of [\d,]+ states.*smaller maze"):
        StateNumbers(make_task("maze", maze="9x9", num_goals=4))
    with pytest.raises(ValueError, match="one maze"):
        StateNumbers(make_task("chase", maze=("3x3", "4x4")))
    task = make_task("maze", maze="3x3", num_goals=1)
    numbers = StateNumbers(task, "runner")
    policy = QTablePolicy(numbers, np.zeros((numbers.count, 4)))
    other = Simulator(make_task("maze", maze="3x3", num_goals=2))
    with pytest.raises(ValueError, match="use the same"):
        policy.act(other.view("runner"))
    with pytest.raises(ValueError, match="not a table over pairs"):
        policy.action_probabilities(task.mazes[0])
