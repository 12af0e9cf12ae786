"""Scripted agents: they play the distributions that define them, in mazes of any size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import networkx
import numpy as np
import pytest
from game_rows import rows_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_mazes import any_maze
from scipy.stats import chisquare

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    RandomAgent,
    TablePolicy,
    TourRunner,
)

MAZE = generate_maze("prim", 6, 6, loops=0.3, seed=3)
DUEL = {"num_chasers": 1, "num_evaders": 1}


# -- the definitions, in plain Python --------------------------------------------------------------


class Plain:
    """One maze as a graph, and what the definitions say of it."""

    def __init__(self, maze: Maze, stay: bool = False) -> None:
        self.stay, self.after = stay, maze.neighbors.tolist()
        graph = networkx.Graph(
            (cell, other) for cell, row in enumerate(self.after) for other in row
        )
        self.lengths = dict(networkx.all_pairs_shortest_path_length(graph))

    def away(self, a: int, b: int) -> float:
        return self.lengths[a].get(b, np.inf)

    def moves(self, own: int) -> set[int]:
        """The moves that change the cell; in an enclosed cell standing still, or a bump north."""
        return {a for a in range(4) if self.after[own][a] != own} or {4 if self.stay else 0}

    def towards(self, own: int, goals: Any) -> set[int]:
        """First steps of shortest paths to the nearest of the goals, or any move."""
        distances = {goal: self.away(own, goal) for goal in goals}
        nearest = min(distances.values(), default=np.inf)
        steps = {
            action
            for action in range(4)
            for goal, distance in distances.items()
            if distance == nearest < np.inf and self.away(self.after[own][action], goal) < distance
        }
        return steps or self.moves(own)

    def fleeing(self, own: int, chasers: Any, alert: int = 3, look: int = 3) -> set[int]:
        """Towards the cell within sight that is farthest from the nearest chaser, if it is near."""
        chaser = min(chasers, key=lambda cell: self.away(own, cell))
        if self.away(own, chaser) >= alert:
            return self.moves(own)
        seen = [cell for cell in self.lengths[own] if self.away(own, cell) <= look]
        farthest = max(self.away(chaser, cell) for cell in seen)
        if self.away(chaser, own) == farthest:
            return {4} if self.stay else self.moves(own)
        return {
            action
            for action in range(4)
            for cell in seen
            if self.away(chaser, cell) == farthest
            and self.away(self.after[own][action], cell) < self.away(own, cell)
        }

    def row(self, greedy: set[int], own: int, epsilon: float) -> NDArray[np.float64]:
        """The probabilities of the actions."""
        row = np.zeros(5 if self.stay else 4)
        for share, chosen in ((1 - epsilon, greedy), (epsilon, self.moves(own))):
            for action in chosen:
                row[action] += share / len(chosen)
        return row


@settings(max_examples=60, deadline=None)
@given(any_maze, st.booleans(), st.sampled_from([0.0, 0.2, 1.0]), st.integers(0, 5), st.data())
def test_probabilities_are_those_of_the_definition(
    maze: Maze, stay: bool, epsilon: float, alert: int, data: st.DataObject
) -> None:
    look = data.draw(st.integers(1, 5), label="look radius")
    plain = Plain(maze, stay)
    tables = {
        "chaser": AStarChaser(epsilon).action_probabilities(maze, stay),
        "evader": AStarEvader(epsilon, alert, look).action_probabilities(maze, stay),
        "random": RandomAgent().action_probabilities(maze, stay),
    }
    for table in tables.values():
        assert table.shape == (maze.num_cells, maze.num_cells, 5 if stay else 4)
        assert (table >= 0).all()
        np.testing.assert_allclose(table.sum(axis=2), 1.0, atol=1e-12)
    for own in range(maze.num_cells):
        for other in set(range(maze.num_cells)) - {own}:
            expected = {
                "chaser": plain.row(plain.towards(own, [other]), own, epsilon),
                "evader": plain.row(plain.fleeing(own, [other], alert, look), own, epsilon),
                "random": plain.row(plain.moves(own), own, 1.0),
            }
            for name, row in expected.items():
                np.testing.assert_allclose(tables[name][own, other], row, atol=1e-12)


# -- they act as their tables say ------------------------------------------------------------------


def actions_at(
    task: Task,
    positions: list[int],
    seat: int,
    policy: Policy,
    games: int,
    goals: list[int] | None = None,
    gone: tuple[int, ...] = (),
    epsilon: Any = None,
) -> NDArray[np.int32]:
    """[games] the actions drawn in one state, by independent games."""
    simulator = Simulator(task, games, seed=11)
    if epsilon is not None:
        simulator.configure(epsilon=epsilon)
    simulator.place(positions, goals)
    simulator.active[:, list(gone)] = 0
    return policy.act(simulator.view(seat))


def assert_drawn_from(actions: NDArray[np.int32], row: NDArray[np.float64]) -> None:
    counts = np.bincount(actions, minlength=len(row))
    assert (counts[row == 0] == 0).all()
    possible = row > 0
    if possible.sum() > 1:
        assert chisquare(counts[possible], row[possible] * len(actions)).pvalue > 1e-4


def random_pairs(count: int, cells: int) -> list[tuple[int, int]]:
    rng = np.random.default_rng(7)
    return [tuple(rng.choice(cells, 2, replace=False).tolist()) for _ in range(count)]


def random_table(maze: Maze, actions: int = 4) -> NDArray[np.float64]:
    """Probabilities with some zeros among them."""
    rng = np.random.default_rng(5)
    table = rng.random((maze.num_cells, maze.num_cells, actions))
    table[rng.random(table.shape) < 0.3] = 0.0
    table[table.sum(axis=2) == 0, 0] = 1.0
    return table / table.sum(axis=2, keepdims=True)


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize(
    "policy",
    [
        AStarChaser(0.25),
        AStarEvader(0.25, alert_distance=6),
        RandomAgent(),
        TablePolicy(MAZE, random_table(MAZE)),
        TablePolicy(MAZE, random_table(MAZE), epsilon=0.4),
    ],
    ids=["chaser", "evader", "random", "table", "table with random moves"],
)
def test_actions_are_drawn_from_the_table(policy: Any, stay: bool) -> None:
    if stay and isinstance(policy, TablePolicy):
        policy = TablePolicy(MAZE, random_table(MAZE, 5), policy.epsilon)
    task = Task(maze=MAZE, stay_action=stay, **DUEL)
    table = policy.action_probabilities(MAZE, stay)
    for own, other in random_pairs(12, MAZE.num_cells):
        for seat in (0, 1):
            positions = [own, other] if seat == 0 else [other, own]
            if isinstance(policy, (AStarEvader, AStarChaser)[seat]):
                continue  # they flee from, or head for, the other role only
            actions = actions_at(task, positions, seat, policy, 4000)
            assert_drawn_from(actions, table[own, other])


def test_the_epsilon_of_a_game_goes_before_that_of_the_agent() -> None:
    task = Task(maze=MAZE, **DUEL)
    policies = {
        0: lambda epsilon: AStarChaser(epsilon),
        1: lambda epsilon: TablePolicy(MAZE, random_table(MAZE), epsilon),
    }
    for seat, policy in policies.items():
        for own, other in random_pairs(5, MAZE.num_cells):
            positions = [own, other] if seat == 0 else [other, own]
            for epsilon, expected in ((0.7, 0.7), (0.0, 0.0), (1.0, 1.0), (np.nan, 0.3)):
                actions = actions_at(task, positions, seat, policy(0.3), 4000, epsilon=epsilon)
                table = policy(expected).action_probabilities(MAZE)
                assert_drawn_from(actions, table[own, other])


@pytest.mark.parametrize("seat", ["chaser", "evader"])
def test_the_share_of_random_moves_in_play_is_the_opponents_epsilon(seat: str) -> None:
    """In games of one batch with epsilons of their own, as a curriculum sets them."""
    task = make_task("chase", maze="7x7", max_steps=40)
    maze, number, games = task.mazes[0], task.seat(seat), 3000
    opponent = AStarChaser() if seat == "chaser" else AStarEvader(alert_distance=6)
    greedy = opponent.action_probabilities(maze)
    shares = np.array([0.0, 0.2, 0.6, 1.0])[np.arange(games) % 4]
    simulator = Simulator(task, games, seed=1)
    simulator.configure(epsilon=shares, seat=seat)
    policies: list[Policy] = [RandomAgent(), RandomAgent()]
    policies[number] = opponent
    actions = np.zeros((games, 2), dtype=np.int32)
    seen, possible = np.zeros(games), np.zeros(games)
    simulator.reset()
    for _ in range(100):
        own, other = simulator.positions[:, number], simulator.positions[:, 1 - number]
        row, moves = greedy[own, other], maze.neighbors[own, :4] != own[:, None]
        # A random move is seen as such where it is none of the greedy ones.
        possible += (moves & (row == 0)).sum(axis=1) / moves.sum(axis=1)
        simulator.act(policies, actions)
        seen += row[np.arange(games), actions[:, number]] == 0
        simulator.step(actions)
    for share in (0.0, 0.2, 0.6, 1.0):
        chosen = shares == share
        measured = seen[chosen].sum() / possible[chosen].sum()
        assert abs(measured - share) < 4 / np.sqrt(possible[chosen].sum())
    assert seen[shares == 0.0].sum() == 0


# -- several targets, and large mazes --------------------------------------------------------------


def test_chasers_head_for_the_nearest_evader_that_is_left() -> None:
    task, plain = Task(maze=MAZE, num_chasers=2, num_evaders=3), Plain(MAZE)
    rng = np.random.default_rng(1)
    for case in range(40):
        cells = rng.choice(MAZE.num_cells, 5, replace=False).tolist()
        gone = ((), (2,), (4,), (2, 3))[case % 4]
        targets = [cells[seat] for seat in (2, 3, 4) if seat not in gone]
        for seat in (0, 1):
            actions = actions_at(task, cells, seat, AStarChaser(), 200, gone=gone)
            assert set(actions) == plain.towards(cells[seat], targets)


def test_evaders_flee_from_the_nearest_chaser() -> None:
    task, plain = Task(maze=MAZE, num_chasers=3, num_evaders=2), Plain(MAZE)
    rng = np.random.default_rng(1)
    for _ in range(40):
        cells = rng.choice(MAZE.num_cells, 5, replace=False).tolist()
        for seat in (3, 4):
            actions = actions_at(task, cells, seat, AStarEvader(), 200)
            assert set(actions) == plain.fleeing(cells[seat], cells[:3])


@pytest.mark.parametrize("tables", [True, False])
@pytest.mark.parametrize(
    "rules",
    [
        {"num_chasers": 2, "n_catch": 2},
        {"num_chasers": 2, "capture": "surround"},
        {"num_chasers": 1, "move_order": "chasers_first", "capture_check": "after_chasers"},
    ],
)
def test_moves_are_random_in_the_cell_of_the_other(
    rules: dict[str, Any], tables: bool, without_tables: Callable[[], None]
) -> None:
    """Of an evader with a chaser in its cell, and of a chaser with an evader in its own."""
    if not tables:
        without_tables()
    maze = Maze.from_text(MAZE.to_text())
    task = Task(maze=maze, num_evaders=1, **rules)
    assert bool(len(lay_out(task.mazes).tables)) == tables
    for shared in range(maze.num_cells):
        moves = {action for action, after in enumerate(maze.neighbors[shared]) if after != shared}
        far = int(MAZE.distances[shared].argmax())
        cells = [shared, far, shared] if task.num_chasers == 2 else [shared, shared]
        for seat, policy in ((task.num_agents - 1, AStarEvader()), (0, AStarChaser())):
            if seat == 0 and task.capture == "surround":
                continue  # goes to a cell of its own
            simulator = Simulator(task, 200, seed=11)
            simulator.games.position[:] = cells
            assert set(policy.act(simulator.view(seat))) == moves


def test_nearest_goal_runners_head_for_the_nearest_goal_that_is_left() -> None:
    plain = Plain(MAZE)
    rng = np.random.default_rng(1)
    for counts in ({"num_runners": 2}, {"num_chasers": 1, "num_evaders": 1}):
        task = Task(maze=MAZE, num_goals=3, **counts)
        for _ in range(30):
            cells = rng.choice(MAZE.num_cells, 5, replace=False).tolist()
            goals = [cells[2], -1, cells[4]]
            actions = actions_at(task, cells[:2], 1, NearestGoalRunner(), 200, goals)
            assert set(actions) == plain.towards(cells[1], [cells[2], cells[4]])


def test_without_distance_tables_whole_games_are_the_same(
    without_tables: Callable[[], None],
) -> None:
    def play(task: Task) -> list[NDArray[np.int32]]:
        simulator = Simulator(task, 10, seed=3)
        evader, runner = AStarEvader(0.2, alert_distance=5), TourRunner(0.1)
        policies = [AStarChaser(0.1), AStarChaser(), evader, evader, runner, NearestGoalRunner()]
        actions, history = np.zeros((10, 6), dtype=np.int32), []
        for _ in range(120):
            simulator.act(policies, actions)
            simulator.step(actions)
            history.append(rows_of(simulator))
        return history

    text = generate_maze("prim", 12, 12, loops=0.2, seed=2).to_text()

    def task() -> Task:
        counts = {"num_chasers": 2, "num_evaders": 2, "num_runners": 2, "num_goals": 3}
        return Task(maze=Maze.from_text(text), max_steps=40, min_start_distance=4, **counts)

    expected = play(task())
    without_tables()
    bare = task()
    assert not len(lay_out(bare.mazes).tables)
    np.testing.assert_array_equal(play(bare), expected)


# -- what they refuse ------------------------------------------------------------------------------


@pytest.mark.parametrize("epsilon", [-0.1, 1.1, np.nan])
def test_a_share_of_random_moves_lies_between_0_and_1(epsilon: float) -> None:
    for kind in (AStarChaser, AStarEvader, NearestGoalRunner, TourRunner):
        with pytest.raises(ValueError, match=r"epsilon=.*probability from 0 to 1"):
            kind(epsilon)
    with pytest.raises(ValueError, match=r"epsilon=.*probability from 0 to 1"):
        TablePolicy(MAZE, random_table(MAZE), epsilon)


@pytest.mark.parametrize("bad", [{"alert_distance": -1}, {"look_radius": 0}])
def test_evaders_refuse_impossible_distances(bad: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        AStarEvader(**bad)


def test_a_table_policy_refuses_other_games() -> None:
    policy = TablePolicy(MAZE, random_table(MAZE))
    with pytest.raises(ValueError, match="is for maze prim-6x6, the games are in 5x5"):
        policy.act(Simulator(make_task("chase")).view(0))
    with pytest.raises(ValueError, match="use the same stay_action"):
        policy.act(Simulator(Task(maze=MAZE, stay_action=True, **DUEL)).view(0))
    with pytest.raises(ValueError, match="4 actions, the games have 5"):
        policy.action_probabilities(MAZE, stay_action=True)
    with pytest.raises(ValueError, match="shape"):
        TablePolicy(MAZE, np.ones((3, 3, 4)) / 4)


def test_tables_are_refused_beyond_their_bound(without_tables: Callable[[], None]) -> None:
    without_tables()
    with pytest.raises(ValueError, match="36 cells; tables have at most"):
        AStarChaser().action_probabilities(generate_maze("open", 6, 6))
