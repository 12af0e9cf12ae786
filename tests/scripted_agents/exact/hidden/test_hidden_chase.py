"""Certified optima under limited sight agree with exact ones, with each other and with play."""

from __future__ import annotations

from functools import cache
from typing import Any

import hidden_truth
import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit import Simulator, load_maze, make_task
from pursuit.mazes.maze import Maze
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BeliefOptimalChaser,
    HiddenChaseSolution,
    RandomAgent,
    best_response,
    mean_over_starts,
    solve_hidden_chase,
)

ORDERS = ("simultaneous", "chasers_first")
LINE = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+", "line")
RING = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n| |#| |\n+ +-+ +\n|     |\n+-+-+-+", "ring")


def opponent(maze: Maze, role: str, epsilon: float = 0.2) -> Any:
    """The opponent's table for the responder in `role`."""
    agent = AStarEvader(epsilon=epsilon) if role == "chaser" else AStarChaser(epsilon=epsilon)
    return agent.action_probabilities(maze)


@cache
def solved(
    name: str, radius: int, role: Any = "chaser", order: Any = "simultaneous", seconds: float = 0.5
) -> HiddenChaseSolution:
    maze = {"line": LINE, "ring": RING}.get(name) or load_maze(name)
    return solve_hidden_chase(
        maze,
        opponent(maze, role, 0.2 if role == "chaser" else 0.6),
        radius,
        seconds=seconds,
        width=1e-4,
        role=role,
        move_order=order,
    )


def drawn_beliefs(seed: int, solution: HiddenChaseSolution, count: int) -> Any:
    """Own cells with beliefs over other cells, some of few cells, some of cells out of view."""
    rng = np.random.default_rng(seed)
    size = solution.maze.num_cells
    for _ in range(count):
        own = int(rng.integers(size))
        weights = rng.random(size) ** rng.integers(1, 8) * (rng.random(size) < rng.random())
        weights[own] = 0.0
        hidden = ~solution.search.game.visible[own]
        if rng.random() < 0.5 and hidden.any():
            weights = np.where(hidden, weights + 1e-6, 0.0)
        if weights.sum() > 0.0:
            yield own, weights / weights.sum()


# -- the interval ----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_with_a_view_of_everything_it_closes_on_the_best_response(role: Any, order: Any) -> None:
    solution = solved("ring", 9, role, order)
    table = solution.opponent_table
    best = best_response(role, RING, table, horizon=None, discount=0.95, move_order=order)
    mean = mean_over_starts(best.values, RING)
    assert solution.lower - 1e-8 <= mean <= solution.upper + 1e-8
    assert solution.upper - solution.lower < 1e-6


@pytest.mark.parametrize(
    ("name", "radius", "role", "order"),
    [
        ("line", 1, "chaser", "chasers_first"),
        ("line", 1, "evader", "simultaneous"),
        pytest.param("2x2", 0, "chaser", "simultaneous", marks=pytest.mark.slow),
        pytest.param("2x2", 0, "evader", "chasers_first", marks=pytest.mark.slow),
        pytest.param("3x3", 1, "chaser", "simultaneous", marks=pytest.mark.slow),
        pytest.param("3x3", 1, "evader", "simultaneous", marks=pytest.mark.slow),
    ],
)
def test_it_holds_the_values_of_exact_value_iteration(
    name: str, radius: int, role: Any, order: Any
) -> None:
    solution = solved(name, radius, role, order)
    game = hidden_truth.chase(solution.maze, solution.opponent_table, radius, role, order)
    sign = 1.0 if role == "chaser" else -1.0
    # From both sides: with nothing to pay after these steps, and with 20 steps to pay.
    most = 20.0 if role == "chaser" else 0.0
    # Of vectors that are left out, in each of infinitely many discounted sweeps: on 3x3 there would
    # be too many of them.
    slack = 1e-4 if name == "3x3" else 1e-7
    least = (
        hidden_truth.exact_values(game, 40, most - 20.0, slack),
        hidden_truth.exact_values(game, 40, most, slack),
    )

    def holds(lower: float, upper: float, low: float, high: float) -> None:
        assert lower <= high + 1e-5 and low - max(20.0 * slack, 1e-5) <= upper

    for own, belief in drawn_beliefs(1, solution, 100):
        if not solution.search.game.visible[own][belief > 0.0].any():
            low, high = (float((vectors[own] @ belief).min()) for vectors in least)
            lower, upper = sorted(sign * bound for bound in solution.bounds(own, belief))
            holds(lower, upper, low, high)
    roots = solution.search.roots
    costs = [
        roots.weight
        @ [(vectors[own] @ belief).min() for own, belief in zip(*roots[:2], strict=True)]
        for vectors in least
    ]
    holds(*sorted((sign * solution.lower, sign * solution.upper)), *costs)
    assert solution.upper - solution.lower < 0.01


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_the_bounds_hold_against_each_other_and_wider_sight_never_harms(role: Any) -> None:
    narrow, wide = solved("4x4", 1, role), solved("4x4", 2, role)
    for own, belief in drawn_beliefs(2, narrow, 300):
        (low, up), (low_wide, up_wide) = narrow.bounds(own, belief), wide.bounds(own, belief)
        assert low <= up and low_wide <= up_wide
        assert low_wide <= up if role == "chaser" else low <= up_wide
    assert narrow.lower <= narrow.upper and narrow.width >= 0.0


def test_a_belief_costs_at_least_what_its_parts_do() -> None:
    solution = solved("4x4", 1)
    for own, belief in drawn_beliefs(3, solution, 40):
        known = sum(
            share * solution.bounds(own, np.eye(len(belief))[cell])[0]
            for cell, share in enumerate(belief)
            if share > 0.0
        )
        assert known <= solution.bounds(own, belief)[1] + 1e-9


# -- who plays it ----------------------------------------------------------------------------------


def discounted(solution: HiddenChaseSolution, opponent: Any, games: int) -> NDArray[np.float64]:
    """[games], the discounted steps of whole games of the policy."""
    rules = solution.rules
    task = make_task(
        "chase", maze=solution.maze, max_steps=400, move_order=rules.move_order,
        view_radius={rules.role: rules.view_radius},
    )  # fmt: skip
    simulator = Simulator(task, games, seed=5, auto_restart=False)
    actions = np.zeros((games, 2), dtype=np.int32)
    policies = (
        [solution.policy, opponent] if rules.role == "chaser" else [opponent, solution.policy]
    )
    while not simulator.ended.all():
        simulator.act(policies, actions)
        simulator.step(actions)
    steps: NDArray[np.float64] = (1.0 - 0.95**simulator.steps) / (1.0 - 0.95)
    return steps


def assert_within(solution: HiddenChaseSolution, steps: NDArray[np.float64]) -> None:
    """The policy's value lies between both bounds; so its estimate, give or take four errors."""
    error = 4.0 * steps.std() / len(steps) ** 0.5
    assert solution.lower - error <= steps.mean() <= solution.upper + error


@pytest.mark.parametrize("order", ORDERS)
def test_games_of_the_chaser_lie_in_the_interval(order: Any) -> None:
    solution = solved("4x4", 1, "chaser", order)
    assert_within(solution, discounted(solution, AStarEvader(epsilon=0.2), 4000))


@pytest.mark.parametrize("order", ORDERS)
def test_games_of_the_evader_lie_in_the_interval(order: Any) -> None:
    solution = solved("3x3", 1, "evader", order)
    assert_within(solution, discounted(solution, AStarChaser(epsilon=0.6), 1000))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "radius", "role", "agent"),
    [
        ("5x5", 2, "chaser", AStarEvader(epsilon=0.2)),
        ("5x5", 1, "chaser", AStarEvader(epsilon=0.2)),
        ("3x3", 1, "evader", AStarChaser(epsilon=0.6)),
    ],
)
def test_many_games_lie_in_the_interval(name: str, radius: int, role: str, agent: Any) -> None:
    solution = solved(name, radius, role, seconds=10.0)
    assert_within(solution, discounted(solution, agent, 20_000))


def test_the_filter_is_bayes_rule() -> None:
    solution = solved("4x4", 1)
    maze, policy = solution.maze, solution.policy
    game = hidden_truth.chase(maze, solution.opponent_table, 1, "chaser", "simultaneous")
    simulator = Simulator(make_task("chase", maze="4x4"), 30, seed=6, auto_restart=False)
    actions = np.zeros((30, 2), dtype=np.int32)
    beliefs = [np.zeros(16)] * 30
    for number in range(25):
        before = simulator.positions.copy()
        simulator.act([policy, AStarEvader(epsilon=0.2)], actions)
        kept = policy.memory.of(simulator.view("chaser"))["belief"]
        for i in np.flatnonzero(simulator.active.all(axis=1)):
            own, other = before[i]
            if number == 0:
                beliefs[i] = np.array([float(not game.sees(own, cell)) for cell in range(16)])
            if game.sees(own, other):
                beliefs[i] = np.eye(16)[other]
            unseen = np.array([not game.sees(own, c) or c == other for c in range(16)])
            beliefs[i] = beliefs[i] * unseen / (beliefs[i] * unseen).sum()
            np.testing.assert_allclose(kept[i], beliefs[i], atol=1e-12)
            beliefs[i] = hidden_truth.step(game, int(own), int(actions[i, 0]), beliefs[i])[2]
        simulator.step(actions)


def test_a_game_does_not_depend_on_its_batch() -> None:
    policy, task = solved("4x4", 1).policy, make_task("chase", maze="4x4", max_steps=40)
    histories = []
    for games in (1, 60):
        simulator = Simulator(task, games, seed=7, first_game=59 if games == 1 else 0)
        seen = []
        actions = np.zeros((games, 2), dtype=np.int32)
        for _ in range(90):
            simulator.act([policy, AStarEvader(epsilon=0.2)], actions)
            simulator.step(actions)
            seen.append(actions[-1].tolist())
        histories.append(seen)
    assert histories[0] == histories[1]


def test_it_plays_on_against_others_and_at_random_as_told() -> None:
    solution = solved("4x4", 1)
    task = make_task("chase", maze="4x4", max_steps=60)
    for policy in (solution.policy, BeliefOptimalChaser(solution, epsilon=0.5)):
        simulator = Simulator(task, 50, seed=8)
        actions = np.zeros((50, 2), dtype=np.int32)
        for _ in range(80):
            simulator.act([policy, RandomAgent()], actions)
            simulator.step(actions)
            belief = policy.memory.of(simulator.view("chaser"))["belief"]
            np.testing.assert_allclose(belief[simulator.steps > 1].sum(axis=1), 1.0)


def test_a_random_move_of_an_enclosed_cell_is_a_legal_action() -> None:
    """There no move changes the cell; what was left unwritten was any number."""
    maze = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+", "enclosed")
    solution = solve_hidden_chase(maze, opponent(maze, "chaser"), 1, seconds=0.2)
    policy = BeliefOptimalChaser(solution, epsilon=1.0)
    simulator = Simulator(make_task("chase", maze=maze, max_steps=5), 8)
    simulator.place([2, 0])
    actions, view = np.zeros((8, 2), dtype=np.int32), simulator.view("chaser")
    policy.begin(view, np.arange(8))
    for _ in range(20):
        freed = np.full(8, 99, dtype=np.int32)  # NumPy hands out such small memory again
        del freed
        actions[:, 0] = policy.act(view)
    assert (actions < 4).all()


# -- going on, and refusals ------------------------------------------------------------------------


def test_a_solution_goes_on() -> None:
    solution = solve_hidden_chase("4x4", opponent(load_maze("4x4"), "chaser"), 0, seconds=0.2)
    lower, upper, seconds, policy = (
        solution.lower,
        solution.upper,
        solution.seconds,
        solution.policy,
    )
    message: list[Any] = []
    solution.improve(0.3, report=lambda *now: message.append(now))
    assert message and solution.seconds > seconds and solution.policy is not policy
    assert "array" not in repr(solution)
    assert solution.lower >= lower and solution.upper <= upper + 1e-9


def test_pruning_never_loosens_the_bounds_of_the_starts() -> None:
    search = solve_hidden_chase("4x4", opponent(load_maze("4x4"), "chaser"), 0, seconds=0.0).search
    search._bound_starts()
    kept = []
    for _ in range(4):
        search._explore(100)  # so many lookaheads, whatever time they take
        search.update_starts()
        low, up, plans = search.roots.low.copy(), search.roots.up.copy(), search.num_plans
        search.prune()
        search.update_starts()
        kept.append(search.num_plans / plans)
        assert (search.roots.up <= up + 1e-9).all() and (search.roots.low >= low - 1e-9).all()
    assert min(kept) < 0.9


@pytest.mark.parametrize(
    ("low", "up", "width"),
    [
        (0.5, 2.0, 3.0),
        (2.0, 3.0, 0.5),
        (-3.0, -2.0, 0.5),
        (-1.0, 1.0, np.inf),
        (1.0, np.inf, np.inf),
    ],
)
def test_the_width_is_relative_to_the_bound_nearer_to_0(
    low: float, up: float, width: float
) -> None:
    search = solve_hidden_chase(LINE, opponent(LINE, "chaser"), 1, seconds=0.1).search
    search.roots.low[:], search.roots.up[:] = low, up
    assert search.width == pytest.approx(width, rel=1e-6)


def test_little_memory_is_kept_to_and_bounds_stay_bounds() -> None:
    table = opponent(load_maze("4x4"), "chaser")
    small = solve_hidden_chase("4x4", table, 0, seconds=1.0, memory=250_000)
    assert small.search.lower_bound.inverse.nbytes < 250_000
    large = solved("4x4", 0)
    assert small.lower <= large.upper and large.lower <= small.upper


def test_refusals() -> None:
    table = opponent(LINE, "chaser")
    for wrong, message in (
        ({"discount": 1.0}, "discount=1.0; give a number above 0 and below 1"),
        ({"view_radius": -1}, "view_radius=-1"),
        ({"role": "runner"}, "unknown role 'runner'"),
        ({"seconds": -1.0}, "seconds=-1.0"),
        ({"width": -0.1}, "width=-0.1"),
        ({"min_start_distance": 9}, "min_start_distance=9 is more than"),
        ({"memory": 10}, "memory=10"),
    ):
        with pytest.raises(ValueError, match=message):
            solve_hidden_chase(LINE, table, **{"seconds": 0.1, **wrong})
    policy = solved("line", 1).policy
    for task, message in (
        (make_task("chase", maze="3x3"), "another game"),
        (make_task("chase", maze=LINE, move_order="chasers_first"), "is solved for move_order"),
        (make_task("chase", maze=LINE, view_radius=0), "wider view"),
    ):
        with pytest.raises(ValueError, match=message):
            policy.act(Simulator(task, 1, seed=0).view("chaser"))
