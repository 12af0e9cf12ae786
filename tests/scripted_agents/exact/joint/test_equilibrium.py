"""Matrix games, the simultaneous chase and the chase in turns against independent truths.

Linear programs of SciPy, closed forms, exact best responses, and plain recursion.
"""

from __future__ import annotations

import itertools
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matrix_values import matrix_value
from random_mazes import seeds, small_maze

from pursuit import memory
from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BestResponder,
    NearestGoalRunner,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
    TablePolicy,
    best_response,
    evaluate_exactly,
    evaluate_joint,
    evaluate_team,
    mean_over_starts,
    solve_chase,
    solve_in_turns,
    solve_matrix_game,
)
from scripted_agents.exact.joint.matrix_games import optimize
from train.evaluation.contest import GameContest
from train.evaluation.matchups import match

RING = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n| |#| |\n+ +-+ +\n|     |\n+-+-+-+")
CORRIDOR = Maze.from_text("+-+-+-+\n|     |\n+-+-+-+")
TWO_PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+")


def check_matrix_game(payoff: Any) -> None:
    game = solve_matrix_game(payoff)
    scale = max(1.0, float(np.abs(payoff).max()))
    for strategy in (game.row, game.column):
        assert strategy.min() >= 0 and strategy.sum() == pytest.approx(1.0)
    # Each strategy guarantees the value, which proves both optimal without any other solver.
    assert (game.row @ payoff).min() >= game.value - 1e-9 * scale
    assert (payoff @ game.column).max() <= game.value + 1e-9 * scale
    assert game.value == pytest.approx(matrix_value(payoff), abs=1e-7 * scale)
    pure = payoff.min(axis=1).max() >= payoff.max(axis=0).min()
    assert game.pure == pure


shapes = st.tuples(st.integers(1, 6), st.integers(1, 25))


@settings(max_examples=300, deadline=None)
@given(shapes.flatmap(lambda s: arrays(np.float64, s, elements=st.floats(-100, 100, width=16))))
def test_matrix_games_have_the_value_of_the_linear_program(payoff: Any) -> None:
    check_matrix_game(payoff)


@settings(max_examples=300, deadline=None)
@given(shapes.flatmap(lambda s: arrays(np.float64, s, elements=st.integers(-2, 2))))
def test_degenerate_matrix_games_full_of_ties(payoff: Any) -> None:
    check_matrix_game(payoff)


@settings(max_examples=100, deadline=None)
@given(seeds, st.integers(1, 6), st.integers(1, 9), st.sampled_from(["rank one", "doubled", "dim"]))
def test_dominated_doubled_and_rank_one_matrix_games(seed: int, m: int, n: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    payoff = rng.normal(size=(m, n))
    if kind == "rank one":
        payoff = np.outer(rng.normal(size=m), rng.normal(size=n))
    elif kind == "doubled":
        payoff = payoff[rng.integers(m, size=m)][:, rng.integers(n, size=n)]
    else:
        payoff[0] = payoff.min(axis=0) - 1.0  # a row that no one should ever play
        if m > 1:
            assert solve_matrix_game(payoff).row[0] == 0.0
    check_matrix_game(payoff)


def test_an_optimal_tableau_is_left_as_it_is() -> None:
    """Also where another solution is as good, whose coefficient is 0."""
    tableau, basis = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.5]]), np.array([1])
    getattr(optimize, "py_func", optimize)(tableau, 1, 1, False, basis)
    assert basis == [1] and tableau[1].tolist() == [0.0, 0.0, 0.5]


def test_matrix_games_with_closed_forms() -> None:
    pennies = solve_matrix_game([[1, -1], [-1, 1]])
    assert pennies.value == pytest.approx(0) and not pennies.pure
    assert pennies.row == pytest.approx([0.5, 0.5]) and pennies.column == pytest.approx([0.5, 0.5])
    rock = solve_matrix_game([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    assert rock.value == pytest.approx(0) and rock.row == pytest.approx([1 / 3] * 3)
    # A 2x2 game without a saddle point: (ad - bc) / (a + d - b - c).
    a, b, c, d = 3.0, -1.0, -2.0, 4.0
    game = solve_matrix_game([[a, b], [c, d]])
    assert game.value == pytest.approx((a * d - b * c) / (a + d - b - c))
    assert game.row[0] == pytest.approx((d - c) / (a + d - b - c))
    constant = solve_matrix_game(np.full((3, 4), 7.5))
    assert constant.value == 7.5 and constant.pure


def test_a_game_that_ends_in_its_first_step_needs_few_sweeps() -> None:
    corridor = Maze.from_text("+-+-+\n|   |\n+-+-+")
    game = solve_chase(corridor, 0.9)
    assert game.mean_over_starts == 1.0 and 1 <= game.sweeps <= 3


@pytest.mark.parametrize(
    ("payoff", "message"),
    [([1.0, 2.0], "shape"), (np.zeros((0, 3)), "shape"), ([[1.0, np.nan]], "finite")],
)
def test_what_is_no_matrix_game_is_refused(payoff: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_matrix_game(payoff)


# -- the simultaneous chase ------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    small_maze,
    st.sampled_from([0.5, 0.9, 0.95]),
    st.booleans(),
    st.sampled_from(["simultaneous", "chasers_first"]),
)
def test_neither_side_can_improve_on_the_equilibrium(
    maze: Maze, discount: float, stay: bool, order: Any
) -> None:
    solved = solve_chase(maze, discount, stay, None, order)
    rest: Any = (None, discount, stay, order)
    against_chaser = best_response("evader", maze, solved.chaser_policy, *rest).values
    against_evader = best_response("chaser", maze, solved.evader_policy, *rest).values
    assert np.abs(against_chaser - solved.values).max() < 1e-6
    assert np.abs(against_evader - solved.values).max() < 1e-6
    met = evaluate_exactly(maze, solved.chaser_policy, solved.evader_policy, None, discount, order)
    assert np.abs(met - solved.values).max() < 1e-6
    assert (np.diag(solved.values) == 0).all()
    apart = ~np.eye(maze.num_cells, dtype=bool)
    assert (solved.values[apart] >= 1 - 1e-9).all()
    assert (solved.values <= 1 / (1 - discount) + 1e-9).all()


@pytest.mark.parametrize("discount", [0.999, 0.99999, 1 - 1e-8])
@pytest.mark.parametrize("name", ["2x2", "3x3-open", "5x5-tree"])
def test_discounts_near_1_are_solved_up_to_the_spacing_of_floats(
    name: str, discount: float
) -> None:
    maze = load_maze(name)
    solved = solve_chase(maze, discount)
    apart = ~np.eye(maze.num_cells, dtype=bool)
    assert solved.sweeps < 100
    if maze.num_loops:  # one chaser never catches it there: every step of all counts
        assert (solved.values[apart] == 1 / (1 - discount)).all()
        return
    # On a tree it is caught within 13 steps, so the discount only takes off what it is short of 1.
    steps = solve_chase(maze, horizon=60).values
    assert np.abs(solved.values - steps).max() < 100 * (1 - discount) + 1e-6
    gap = (
        best_response("evader", maze, solved.chaser_policy, None, discount).values
        - best_response("chaser", maze, solved.evader_policy, None, discount).values
    )
    assert np.abs(gap).max() < 1e-6


@pytest.mark.parametrize("name", ["5x5", "7x7", "7x7-tree", "9x9-open"])
def test_the_duality_gap_of_shipped_mazes(name: str) -> None:
    maze = load_maze(name)
    solved = solve_chase(maze)
    rest: Any = (None, 0.95, False)
    gap = (
        best_response("evader", maze, solved.chaser_policy, *rest).values
        - best_response("chaser", maze, solved.evader_policy, *rest).values
    )
    assert np.abs(gap).max() < 1e-6


def captured(maze: Maze, order: str, team: Any, evader: int, after: Any, flight: int) -> bool:
    for before, cell in zip(team, after, strict=True):
        if cell == flight or (cell == evader and (order == "chasers_first" or flight == before)):
            return True
    return False


def value_by_recursion(maze: Maze, chasers: int, steps: int, stay: bool, order: str) -> Any:
    """{(team, evader): value} of the game cut after `steps`, by linear programs."""
    actions = 5 if stay else 4
    cells = range(maze.num_cells)

    @cache
    def value(team: Any, evader: int, left: int) -> float:
        if left == 0 or evader in team:
            return 0.0
        rows = []
        for flee in range(actions):
            flight = int(maze.neighbors[evader, flee])
            row = []
            for joint in itertools.product(range(actions), repeat=chasers):
                after = tuple(int(maze.neighbors[c, a]) for c, a in zip(team, joint, strict=True))
                caught = captured(maze, order, team, evader, after, flight)
                row.append(0.0 if caught else value(after, flight, left - 1))
            rows.append(row)
        return 1.0 + matrix_value(np.array(rows))

    teams = itertools.product(cells, repeat=chasers)
    return {(team, evader): value(team, evader, steps) for team in teams for evader in cells}


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize(
    ("maze", "chasers", "stay"),
    [(load_maze("2x2-open"), 1, True), (RING, 1, False), (CORRIDOR, 1, True), (CORRIDOR, 2, False)],
)
def test_horizons_agree_with_recursion_over_linear_programs(
    maze: Maze, chasers: int, stay: bool, order: Any
) -> None:
    horizon = 4
    solved = solve_chase(maze, 0.95, stay, horizon, order, chasers)
    for (team, evader), value in value_by_recursion(maze, chasers, horizon, stay, order).items():
        assert solved.values[(*team, evader)] == pytest.approx(value, abs=1e-7)


def test_two_chasers_on_5x5_are_solved_and_better_than_one() -> None:
    maze = load_maze("5x5")
    one, two = solve_chase(maze), solve_chase(maze, num_chasers=2)
    assert two.values.shape == (25, 25, 25) and two.chaser_policy.shape == (25, 25, 25, 16)
    assert two.evader_policy.shape == (25, 25, 25, 4)
    assert two.values == pytest.approx(two.values.swapaxes(0, 1), abs=1e-6)
    for first in range(25):
        assert (two.values[first] <= one.values + 1e-6).all()
    # One step back from the values, at drawn places, by an independent program.
    rng = np.random.default_rng(0)
    for c, d, e in rng.integers(25, size=(40, 3)):
        if e in (c, d):
            assert two.values[c, d, e] == 0
            continue
        payoff = np.zeros((4, 16))
        for flee, (joint, (a, b)) in itertools.product(
            range(4), enumerate(itertools.product(range(4), repeat=2))
        ):
            flight, after = maze.neighbors[e, flee], (maze.neighbors[c, a], maze.neighbors[d, b])
            if not captured(maze, "simultaneous", (c, d), e, after, flight):
                payoff[flee, joint] = two.values[(*after, flight)]
        assert two.values[c, d, e] == pytest.approx(1 + 0.95 * matrix_value(payoff), abs=1e-6)
        x, y = two.chaser_policy[c, d, e], two.evader_policy[e, c, d]
        assert 1 + 0.95 * (payoff @ x).max() == pytest.approx(two.values[c, d, e], abs=1e-6)
        assert 1 + 0.95 * (y @ payoff).min() == pytest.approx(two.values[c, d, e], abs=1e-6)


def test_where_play_must_be_random_is_told_from_rounding() -> None:
    """On a ring the evader runs on for ever, so a pure move is optimal wherever it stands."""
    assert not solve_chase(RING).mixed.any()
    pair = solve_chase(load_maze("3x3-open"), num_chasers=2)
    assert pair.mixed.any() and not pair.mixed.all()
    surest = np.minimum(
        pair.chaser_policy.max(axis=-1), np.moveaxis(pair.evader_policy.max(axis=-1), 0, -1)
    )
    assert surest[pair.mixed].max() < 1.0  # one side at least draws its move there


def test_an_evader_that_cannot_be_reached_is_never_caught() -> None:
    values = solve_chase(TWO_PARTS, 0.9).values
    assert values[0, 2] == pytest.approx(10.0) and values[0, 1] < 10.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"discount": 1.0}, "discount=1.0"),
        ({"discount": 0.0}, "discount=0.0"),
        ({"horizon": 0}, "horizon=0"),
        ({"num_chasers": 0}, "num_chasers=0"),
        ({"num_chasers": 3}, "needs 5,310,835,157,256 bytes"),
        ({"move_order": "evaders_first"}, "move_order"),
    ],
)
def test_games_that_cannot_be_solved_say_why(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_chase(load_maze("15x15"), **arguments)


def test_sizes_beyond_memory_are_refused_with_their_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    maze, table = load_maze("15x15"), np.zeros((225, 225, 4))
    chase, both = make_task("chase"), {"chaser": AStarChaser(), "evader": AStarEvader()}
    assert memory.free_memory() > 10**7
    with pytest.raises(ValueError, match=r"needs 15,[0-9,]+ bytes .* limit is"):
        solve_chase(maze, num_chasers=2)
    monkeypatch.setattr(memory, "free_memory", lambda: 1000)
    solve_chase(maze)  # a small size is tried whatever is reported
    monkeypatch.setattr(memory, "SMALL", 0)
    for call in (
        lambda: solve_chase(maze),
        lambda: solve_in_turns(maze),
        lambda: best_response("chaser", maze, table),
        lambda: evaluate_team(chase, both),
    ):
        with pytest.raises(ValueError, match=r"needs [0-9,]+ bytes .* 1,000 are free here"):
            call()
    with pytest.raises(ValueError, match=r"states .* needs [0-9,]+ bytes") as refused:
        evaluate_joint(chase, both)
    states, size = re.findall(r"([0-9,]+) (?:states|bytes)", str(refused.value))[:2]
    # Two float64 of at least three expectations, that of steps and that of each agent's return.
    assert int(size.replace(",", "")) > 3 * 2 * 8 * int(states.replace(",", ""))


def test_long_solutions_say_how_far_they_are() -> None:
    shares: list[float] = []
    solve_chase(load_maze("4x4-open"), 0.9375, num_chasers=2, report=shares.append)
    assert shares and shares == sorted(shares) and 0 <= shares[0] <= shares[-1] <= 1
    count = len(shares)
    solve_chase(load_maze("4x4-open"), 0.9375, num_chasers=2, report=shares.append)
    assert len(shares) == count  # it was kept


# -- agents that play solutions --------------------------------------------------------------------


def test_optimal_agents_play_the_equilibrium_in_the_simulator() -> None:
    task = make_task("chase", maze="5x5-tree", max_steps=400)
    maze = task.mazes[0]
    solved = solve_chase(maze)
    chaser, evader = OptimalChaser(), OptimalEvader()
    assert (chaser.action_probabilities(maze) == solved.chaser_policy).all()
    assert (evader.action_probabilities(maze) == solved.evader_policy).all()
    simulator = Simulator(task, 40_000, seed=3)
    starts = simulator.positions.copy()
    left, total, discount = np.ones(40_000, dtype=bool), np.zeros(40_000), 1.0
    actions = np.zeros((40_000, 2), dtype=np.int32)
    for _ in range(120):
        simulator.act([chaser, evader], actions)
        simulator.step(actions)
        total[left] += discount
        left &= ~simulator.terminated
        discount *= 0.95
    expected = solved.values[starts[:, 0], starts[:, 1]]
    error = total.mean() - expected.mean()
    assert abs(error) < 4 * total.std() / 200


def test_no_agent_beats_the_optimal_ones() -> None:
    maze = load_maze("5x5-tree")
    solved = solve_chase(maze)
    for chaser in (AStarChaser(), RandomAgent(), OptimalChaser(0.3)):
        table = chaser.action_probabilities(maze)
        met = evaluate_exactly(maze, table, solved.evader_policy, None, 0.95)
        assert (met >= solved.values - 1e-6).all()
    for evader in (AStarEvader(), RandomAgent(), OptimalEvader(0.3)):
        table = evader.action_probabilities(maze)
        met = evaluate_exactly(maze, solved.chaser_policy, table, None, 0.95)
        assert (met <= solved.values + 1e-6).all()


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
def test_a_best_responder_gets_the_best_response_value(order: Any) -> None:
    task = make_task("chase", maze="5x5", move_order=order)
    maze, opponent = task.mazes[0], AStarEvader(0.2)
    responder = BestResponder(opponent)
    assert responder.role == "chaser"
    best = best_response("chaser", maze, opponent.action_probabilities(maze), 200, 1.0, None, order)
    optimum = mean_over_starts(best.values, maze)
    contest = GameContest(task, "chaser", {"evader": opponent}, 4000)
    assert contest.play(responder)[0].mean() == pytest.approx(optimum, rel=0.05)
    # Discounted and stationary against cut at the horizon: close, and never better.
    if order == "simultaneous":
        assert optimum - 1e-9 <= match(task, responder, opponent).steps <= 1.02 * optimum
    assert BestResponder(AStarChaser()).role == "evader"
    assert BestResponder(TablePolicy(maze, opponent.action_probabilities(maze)), "chaser")


def test_epsilon_mixes_random_moves_into_exact_play() -> None:
    maze = load_maze("5x5")
    mixed = OptimalChaser(epsilon=0.25).action_probabilities(maze)
    parts = OptimalChaser().action_probabilities(maze), RandomAgent().action_probabilities(maze)
    assert mixed == pytest.approx(0.75 * parts[0] + 0.25 * parts[1])


def test_exact_agents_say_where_they_cannot_play() -> None:
    with pytest.raises(ValueError, match="plays either role"):
        BestResponder(TablePolicy(load_maze("2x2"), np.full((4, 4, 4), 0.25)))
    with pytest.raises(ValueError, match="no action_probabilities"):
        BestResponder(object())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="epsilon=2"):
        OptimalChaser(epsilon=2)
    simulator = Simulator(make_task("chase", maze=["3x3", "4x4"]))
    with pytest.raises(ValueError, match="one maze"):
        simulator.act([OptimalChaser(), None], np.zeros((1, 2), dtype=np.int32))
    with pytest.raises(ValueError, match="evader_0 needs one of the evader"):
        Simulator(make_task("chase")).act([None, OptimalChaser()], np.zeros((1, 2), dtype=np.int32))
    with pytest.raises(ValueError, match="roles here"):
        BestResponder(NearestGoalRunner(), "runner")  # type: ignore[arg-type]


NEARLY_EQUAL = np.array(
    [
        [0.2250172189061016, 1.0, -0.95, -0.95, -0.95],
        [0.7261693914322345, -0.05887292002561098, 1.0, 0.6341757062848863, -0.95],
        [0.22501721890610205, 1.0, -0.95, -0.95, -0.95],
        [0.7590195605208808, 1.0, -0.95, -0.95, -0.95],
        [0.6465743563895492, -0.01860981790611489, -0.95, -0.95, 1.0],
        [0.7590195605208808, -0.058872920025612674, 1.0, 0.6341757062853162, -0.95],
        [0.6731771991564963, -0.058872920025610564, 1.0, 0.6341732971705316, -0.95],
    ]
)
"""Payoffs that differ by rounding: the simplex method divides by such differences."""


def test_matrices_with_nearly_equal_payoffs_are_solved() -> None:
    random, matrices = np.random.default_rng(0), [NEARLY_EQUAL]
    for _ in range(1500):
        rows, columns = random.integers(2, 30), random.integers(2, 10)
        pool = np.append([-0.95, 1.0], random.normal(size=6))
        pool = np.concatenate([pool, *(pool + e * random.normal(size=8) for e in (1e-6, 1e-9))])
        payoff = random.choice(pool, (rows, columns))
        matrices.append(payoff[random.integers(0, rows, rows)])
    for payoff in matrices:
        solved = solve_matrix_game(payoff)
        concedes, gets = (payoff @ solved.column).max(), (solved.row @ payoff).min()
        # Both guarantees bound the value of the game, whatever a solver says.
        assert gets - 1e-6 <= solved.value <= concedes + 1e-6 and concedes - gets < 1e-6
