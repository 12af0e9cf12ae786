"""Best responses and exact values agree with independent truths and with plain simulation.

The rules of capture stand here once more, in plain Python.
"""

from __future__ import annotations

import importlib
import itertools
import json
import warnings
from functools import cache
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_mazes import connected_maze, seeds, small_maze

from pursuit.mazes.maze import Maze
from scripted_agents import RandomAgent
from scripted_agents.exact.duel import value_iteration
from scripted_agents.exact.duel.best_response import MoveOrder

# The package exports a function of the same name as this module.
solver = importlib.import_module("scripted_agents.exact.duel.best_response")

Table = NDArray[np.float64]
ROLES: tuple[Literal["chaser", "evader"], ...] = ("chaser", "evader")
ORDERS: tuple[MoveOrder, ...] = ("simultaneous", "chasers_first")

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
HOOK = Maze.from_text("+-+-+\n|   |\n+-+ +\n|   |\n+-+-+")  # four cells in a row, folded
RING = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n| |#| |\n+ +-+ +\n|     |\n+-+-+-+")
TWO_PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+")


def random_table(seed: int, maze: Maze, num_actions: int = 4, sharp: float = 1.0) -> Table:
    """Every action with some probability; the sharper, the more one stands out."""
    rng = np.random.default_rng(seed)
    table = rng.random((maze.num_cells, maze.num_cells, num_actions)) ** sharp
    table /= table.sum(axis=2, keepdims=True)
    return table


def captures(order: str, chaser: int, evader: int, chaser_after: int, evader_after: int) -> bool:
    if order == "chasers_first":
        return chaser_after in (evader, evader_after)
    return chaser_after == evader_after or (chaser_after, evader_after) == (evader, chaser)


def transitions(maze: Maze, order: str, chaser: int, evader: int, action: int, other: int) -> Any:
    """The pair of cells after these actions of chaser and evader, or None after capture."""
    after = int(maze.neighbors[chaser, action]), int(maze.neighbors[evader, other])
    return None if captures(order, chaser, evader, *after) else after


def transition_rows(maze: Maze, order: str, role: str, table: Table, num_actions: int) -> Table:
    """[own cell, other cell, own action, pair afterwards]: chances against a table opponent."""
    size = maze.num_cells
    rows = np.zeros((size, size, num_actions, size, size))
    for own, other, action in itertools.product(range(size), range(size), range(num_actions)):
        for theirs in range(table.shape[2]):
            pair, actions = (own, other), (action, theirs)
            if role == "evader":
                pair, actions = pair[::-1], actions[::-1]
            after = transitions(maze, order, *pair, *actions)
            if own != other and after is not None:
                after = after if role == "chaser" else after[::-1]
                rows[own, other, action][after] += table[other, own, theirs]
    return rows.reshape(size, size, num_actions, size * size)


def solve(rows: Table, discount: float) -> Table:
    """Expected steps of Markov chains [..., pair, pair]; 0 where both are in one cell."""
    size = int(rows.shape[-1] ** 0.5)
    costs = 1.0 - np.eye(size).reshape(-1)
    system = np.eye(size * size) - discount * rows
    solved = np.linalg.solve(system, np.broadcast_to(costs, rows.shape[:-1])[..., None])[..., 0]
    return np.asarray(solved, dtype=np.float64)


@pytest.mark.parametrize("stay_action", [False, True])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("role", ROLES)
def test_best_response_equals_expectimax(
    role: Literal["chaser", "evader"], order: MoveOrder, stay_action: bool
) -> None:
    maze, best_of = connected_maze(3, 3, 3), min if role == "chaser" else max
    table = random_table(1, maze, 5, sharp=3.0)

    @cache
    def value(chaser: int, evader: int, steps: int) -> float:
        if steps == 0 or chaser == evader:
            return 0.0
        own, other = (chaser, evader) if role == "chaser" else (evader, chaser)
        results = []
        for action in range(4 + stay_action):
            result = 1.0
            for theirs in range(5):
                pair = (action, theirs) if role == "chaser" else (theirs, action)
                after = transitions(maze, order, chaser, evader, *pair)
                if after is not None:
                    result += 0.9 * table[other, own, theirs] * value(*after, steps - 1)
            results.append(result)
        return best_of(results)

    for horizon in (1, 2, 5):
        found = solver.best_response(role, maze, table, horizon, 0.9, stay_action, order)
        for pair in itertools.product(range(maze.num_cells), repeat=2):
            assert found.values[pair] == pytest.approx(value(*pair, horizon), abs=1e-12)
    assert found.policy.shape == (maze.num_cells, maze.num_cells, 4 + stay_action)
    assert (found.policy.sum(axis=2) == 1).all() and (found.policy.max(axis=2) == 1).all()


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("role", ROLES)
def test_best_response_equals_the_best_of_all_policies(
    role: Literal["chaser", "evader"], order: MoveOrder
) -> None:
    table = random_table(5, HOOK, sharp=2.0)
    rows = transition_rows(HOOK, order, role, table, 4).reshape(16, 4, 16)
    # The actions that lead to different cells: the moves, and the first bump.
    distinct = [np.unique(HOOK.neighbors[cell, :4], return_index=True)[1] for cell in range(4)]
    options = [distinct[c] if c != e else [0] for c, e in itertools.product(range(4), repeat=2)]
    policies = np.array(list(itertools.product(*options)))
    values = solve(rows[np.arange(16), policies], 0.95)
    best = values.min(axis=0) if role == "chaser" else values.max(axis=0)
    best = best.reshape(4, 4) if role == "chaser" else best.reshape(4, 4).T
    found = solver.best_response(role, HOOK, table, None, 0.95, move_order=order)
    np.testing.assert_allclose(found.values, best, rtol=1e-8)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("discount", [1.0, 0.9])
@settings(max_examples=15, deadline=None)
@given(small_maze, seeds)
def test_exact_values_solve_the_linear_system_of_the_chain(
    order: MoveOrder, discount: float, maze: Maze, seed: int
) -> None:
    chaser, evader = random_table(seed, maze, 5), random_table(seed + 1, maze, 4, sharp=3.0)
    rows = transition_rows(maze, order, "chaser", evader, 5)
    chain = (rows * chaser[..., None]).sum(axis=2).reshape(maze.num_cells**2, -1)
    values = solver.evaluate_exactly(maze, chaser, evader, None, discount, order)
    np.testing.assert_allclose(values.values.ravel(), solve(chain, discount), rtol=1e-8)


@pytest.mark.parametrize("order", ORDERS)
def test_exact_values_lie_in_the_interval_of_200_000_simulated_games(
    order: MoveOrder,
) -> None:
    rng, games, horizon = np.random.default_rng(0), 200_000, 40
    maze = connected_maze(4, 4, 4)
    evader_table = random_table(1, maze, 4, sharp=4.0)
    answer = solver.best_response("chaser", maze, evader_table, None, 0.99, True, order)
    values = solver.evaluate_exactly(maze, answer.policy, evader_table, horizon, 1.0, order)
    chaser = rng.integers(maze.num_cells, size=games)
    evader = (chaser + rng.integers(1, maze.num_cells, size=games)) % maze.num_cells
    exact = solver.mean_over_starts(values, maze)
    steps, playing = np.zeros(games), np.arange(games)
    for _ in range(horizon):
        steps[playing] += 1
        uniform = rng.random(len(playing))[:, None]
        action = (answer.policy[chaser, evader].cumsum(axis=1) <= uniform).sum(axis=1)
        other = evader_table[evader, chaser].cumsum(axis=1) < rng.random(len(playing))[:, None]
        chaser_after = maze.neighbors[chaser, action]
        evader_after = maze.neighbors[evader, other.sum(axis=1).clip(max=3)]
        caught = chaser_after == evader_after
        if order == "chasers_first":
            caught |= chaser_after == evader
        else:
            caught |= (chaser_after == evader) & (evader_after == chaser)
        chaser, evader, playing = chaser_after[~caught], evader_after[~caught], playing[~caught]
    assert abs(steps.mean() - exact) < 2.5 * steps.std() / games**0.5


@settings(max_examples=25, deadline=None)
@given(small_maze, seeds, st.sampled_from(ORDERS), st.sampled_from([1, 7, None]))
def test_no_policy_beats_the_best_response(
    maze: Maze, seed: int, order: MoveOrder, horizon: int | None
) -> None:
    tables = random_table(seed, maze), random_table(seed + 1, maze, sharp=5.0)
    discount = 1.0 if horizon else 0.9
    played = solver.evaluate_exactly(maze, *tables, horizon, discount, order)
    settings = {"horizon": horizon, "discount": discount, "move_order": order}
    chaser = solver.best_response("chaser", maze, tables[1], **settings)  # type: ignore[arg-type]
    evader = solver.best_response("evader", maze, tables[0], **settings)  # type: ignore[arg-type]
    assert (chaser.values <= played.values + 1e-7).all()
    assert (played.values <= evader.values + 1e-7).all()


@pytest.mark.parametrize("order", ORDERS)
def test_the_stationary_best_response_plays_what_it_promises(order: MoveOrder) -> None:
    maze = connected_maze(6, 5, 5)
    chaser, evader = random_table(1, maze), random_table(2, maze, sharp=3.0)
    found = solver.best_response("chaser", maze, evader, None, move_order=order)
    values = solver.evaluate_exactly(maze, found.policy, evader, None, move_order=order)
    np.testing.assert_allclose(values, found.values, rtol=1e-7)
    found = solver.best_response("evader", maze, chaser, None, 0.95, True, order)
    values = solver.evaluate_exactly(maze, chaser, found.policy, None, 0.95, order)
    np.testing.assert_allclose(values, found.values, rtol=1e-7)


@pytest.mark.parametrize("order", ORDERS)
def test_a_long_horizon_tends_to_the_stationary_values(order: MoveOrder) -> None:
    chaser = random_table(1, HOOK, sharp=3.0)
    found = solver.best_response("evader", HOOK, chaser, None, move_order=order)
    values = solver.evaluate_exactly(HOOK, chaser, found.policy, None, move_order=order)
    np.testing.assert_allclose(values, found.values, rtol=1e-7)
    long = solver.best_response("evader", HOOK, chaser, 100_000, move_order=order)
    np.testing.assert_allclose(long.values, found.values, rtol=2e-6)


def test_a_still_evader_is_caught_after_the_distance_between_them() -> None:
    maze = connected_maze(7, 8, 8)
    still = np.zeros((maze.num_cells, maze.num_cells, 5))
    still[:, :, 4] = 1.0
    for horizon in (200, None):
        found = solver.best_response("chaser", maze, still, horizon)
        assert (found.values == maze.distances).all()
    values = solver.best_response("chaser", maze, still, horizon=5).values
    assert (values == np.minimum(maze.distances, 5)).all()


def test_the_first_best_action_is_a_move_before_standing_still() -> None:
    # An evader that cannot be caught within the horizon: all actions of the chaser are equal.
    still = np.tile([1.0, 0.0, 0.0, 0.0], (5, 5, 1))
    found = solver.best_response("chaser", CORRIDOR, still, horizon=1)
    assert found.actions[0, 4] == 2 and found.actions[2, 4] == 2 and found.actions[4, 0] == 3
    cornered = solver.best_response("evader", CORRIDOR, still, horizon=5)
    assert cornered.actions[0, 1] == 0  # its best is to stay, by the first wall
    cornered = solver.best_response("evader", CORRIDOR, still, horizon=5, stay_action=True)
    assert cornered.actions[0, 1] == 4


def test_more_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    maze = connected_maze(8, 9, 9)
    table = random_table(3, maze)
    alone = solver.best_response("evader", maze, table)
    monkeypatch.setattr(value_iteration, "THREADED_ROWS", 1)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    threaded = solver.best_response("evader", maze, table)
    assert (threaded.values == alone.values).all() and (threaded.actions == alone.actions).all()


def test_the_mean_over_starts_is_that_of_the_pairs_far_enough_apart() -> None:
    gaps = CORRIDOR.distances
    assert solver.mean_over_starts(gaps, CORRIDOR) == pytest.approx(2.0)
    assert solver.mean_over_starts(gaps, CORRIDOR, min_start_distance=3) == pytest.approx(20 / 6)
    with pytest.raises(ValueError, match="min_start_distance=5 is more than the largest"):
        solver.mean_over_starts(gaps, CORRIDOR, 5)
    with pytest.raises(ValueError, match="values has shape"):
        solver.mean_over_starts(gaps[:2], CORRIDOR)


def test_a_hunt_that_need_not_end_is_refused_without_a_horizon() -> None:
    # On a ring the evader keeps its distance from any chaser that it sees.
    chaser = np.zeros((RING.num_cells, RING.num_cells, 4))
    for own, other in itertools.product(range(RING.num_cells), repeat=2):
        chaser[own, other, np.argmin(RING.distances[RING.neighbors[own, :4], other])] = 1.0
    with pytest.raises(ValueError, match=r"avoided forever.*give a horizon, or a discount"):
        solver.best_response("evader", RING, chaser, horizon=None)
    kept = solver.best_response("evader", RING, chaser, horizon=None, discount=0.9)
    assert kept.values.max() == pytest.approx(10.0)
    assert solver.best_response("evader", RING, chaser, horizon=50).values.max() == 50
    flees = solver.best_response("evader", RING, chaser, horizon=50).policy
    with pytest.raises(ValueError, match="avoided forever"):
        solver.evaluate_exactly(RING, chaser, flees, horizon=None)
    with pytest.raises(ValueError, match="avoided forever"):
        solver.best_response("chaser", TWO_PARTS, random_table(0, TWO_PARTS), horizon=None)


def spoiled(table: Table, place: tuple[int, ...], value: float) -> Table:
    table = table.copy()
    table[place] = value
    return table


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"opponent_table": np.ones((5, 5))}, "opponent_table has shape"),
        ({"opponent_table": np.ones((4, 4, 4)) / 4}, "5 cells needs"),
        ({"opponent_table": np.ones((5, 5, 3)) / 3}, r"\(5, 5, 4\), or \(5, 5, 5\) with stay"),
        ({"spoil": 0.5}, "self cell 1 and other cell 3 are .* sum 1.25"),
        ({"spoil": -0.25}, "give non-negative ones"),
        ({"spoil": float("nan")}, "self cell 1 and other cell 3"),
        ({"role": "runner"}, "role='runner'; give 'chaser'"),
        ({"horizon": 0}, "horizon=0; it is at least 1"),
        ({"discount": 0.0}, "discount=0.0; give"),
        ({"move_order": "evaders_first"}, "move_order='evaders_first'; give"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    table = np.full((5, 5, 4), 0.25)
    if "spoil" in arguments:
        table = spoiled(table, (1, 3, 0), arguments.pop("spoil"))
    with pytest.raises(ValueError, match=message):
        solver.best_response(
            **{"role": "chaser", "maze": CORRIDOR, "opponent_table": table, **arguments}
        )


def test_the_diagonal_of_a_table_is_not_looked_at() -> None:
    table = random_table(0, CORRIDOR)
    broken = spoiled(table, (np.arange(5), np.arange(5)), float("nan"))  # type: ignore[arg-type]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        values = solver.evaluate_exactly(CORRIDOR, broken, broken, 30)
    assert (values == solver.evaluate_exactly(CORRIDOR, table, table, 30)).all()


def test_a_maze_too_large_for_tables_is_refused() -> None:
    room = Maze(np.ones((65, 64), bool), np.ones((64, 64), bool), np.ones((65, 63), bool))
    with pytest.raises(ValueError, match="4160 cells; duels are solved"):
        solver.best_response("chaser", room, np.zeros((1, 1, 4)))


@pytest.mark.parametrize("seed", range(12))
def test_discounted_values_of_nearly_certain_opponents_converge(seed: int) -> None:
    """Learned opponents are like this: rare moves beside sure ones; changes die out in steps."""
    maze = connected_maze(seed, 3, 3)
    table = random_table(seed, maze, sharp=60.0)
    for role in ROLES:
        stationary = solver.best_response(role, maze, table, None, 0.95).values
        truth = solver.best_response(role, maze, table, 2000, 0.95).values
        assert stationary == pytest.approx(truth, abs=1e-7)
    other = random_table(seed + 100, maze, sharp=60.0)
    met = solver.evaluate_exactly(maze, table, other, None, 0.95)
    assert met == pytest.approx(solver.evaluate_exactly(maze, table, other, 2000, 0.95), abs=1e-7)


def test_what_is_computed_from_exact_values_is_plain() -> None:
    maze = CORRIDOR
    table = RandomAgent().action_probabilities(maze)
    values = solver.evaluate_exactly(maze, table, table)
    for number in (values.mean(), values.max(), values.sum(), values[0, 1]):
        assert isinstance(number, float) and json.loads(json.dumps(number)) == number
    assert json.loads(json.dumps((2 * values).tolist()))[0][0] == 0.0
    assert type(values.mean(axis=0)) is np.ndarray and type(values + 1) is np.ndarray
    assert values.values.mean() == values.mean()


# -- captures --------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("horizon", [1, 4, 9])
def test_captures_are_those_of_the_actions_of_every_step(
    order: MoveOrder, role: Any, horizon: int
) -> None:
    """Of equally good actions those with more captures for chasers, with fewer for evaders."""
    maze, sign = RING, 1.0 if role == "chaser" else -1.0
    table = random_table(3, maze, sharp=3.0)
    pairs = list(itertools.permutations(range(maze.num_cells), 2))
    found = solver.best_response(role, maze, table, horizon, move_order=order)
    steps, still = dict.fromkeys(pairs, 0.0), dict.fromkeys(pairs, 1.0)
    for _ in range(horizon):
        best = {}
        for chaser, evader in pairs:
            own, other = (chaser, evader) if role == "chaser" else (evader, chaser)
            options = []
            for action in range(4):
                mean = np.zeros(2)
                for reply, chance in enumerate(table[other, own]):
                    moves = (action, reply) if role == "chaser" else (reply, action)
                    after = transitions(maze, order, chaser, evader, *moves)
                    if after is not None:
                        mean += chance * np.array([steps[after], still[after]])
                options.append((round(sign * mean[0], 9), sign * mean[1], *mean))
            best[chaser, evader] = min(options)
        steps = {pair: 1.0 + each[2] for pair, each in best.items()}
        still = {pair: each[3] for pair, each in best.items()}
    for pair in pairs:
        assert found.values[pair] == pytest.approx(steps[pair], rel=1e-9)
        assert found.captured[pair] == pytest.approx(1.0 - still[pair], abs=1e-6)
    assert (np.diag(found.captured) == 1.0).all()
    with pytest.raises(ValueError, match="with a horizon"):
        _ = solver.best_response(role, maze, table, None, 0.9).captured
