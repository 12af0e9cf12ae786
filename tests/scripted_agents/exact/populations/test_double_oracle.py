"""Double oracle and restricted games against the full solution and plain value iteration."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from scripted_agents import double_oracle, solve_chase, solve_matrix_game
from scripted_agents.exact.duel.best_response import MoveOrder
from train.evaluation.exploitability import duel_nash_conv

MAZES = [
    load_maze("3x3-open"),
    load_maze("4x4-tree"),
    load_maze("5x5-tree"),
    load_maze("5x5"),
    load_maze("5x5-open"),
    *(generate_maze("prim", height=4, width=5, loops=0.1 * seed, seed=seed) for seed in range(5)),
]


def random_mask(maze: Maze, actions: int, seed: int) -> NDArray[np.bool_]:
    rng = np.random.default_rng(seed)
    shape = (maze.num_cells, maze.num_cells)
    mask = rng.random((*shape, actions)) < 0.4
    mask[(*np.indices(shape), rng.integers(actions, size=shape))] = True
    return mask


def plain_values(
    maze: Maze, chaser: NDArray[np.bool_], evader: NDArray[np.bool_], discount: float
) -> NDArray[np.float64]:
    """Shapley's iteration with loops, of simultaneous moves."""
    values = np.zeros((maze.num_cells, maze.num_cells))
    for _ in range(60):
        before = values.copy()
        for c, e in np.argwhere(~np.eye(maze.num_cells, dtype=bool)):
            payoff = np.array(
                [
                    [
                        1.0
                        + discount * (0.0 if mine == theirs or (mine, theirs) == (e, c) else after)
                        for a in np.flatnonzero(chaser[c, e])
                        for mine in [maze.neighbors[c, a]]
                        for after in [before[mine, theirs]]
                    ]
                    for b in np.flatnonzero(evader[e, c])
                    for theirs in [maze.neighbors[e, b]]
                ]
            )
            values[c, e] = solve_matrix_game(payoff).value
    return values


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize("name", ["2x2", "3x3", "3x3-open"])
def test_restricted_game_against_plain_iteration(name: str, stay: bool) -> None:
    maze, actions = load_maze(name), 4 + stay
    chaser, evader = (random_mask(maze, actions, seed) for seed in (1, 2))
    solution = solve_chase(maze, 0.6, stay, allowed=(chaser, evader))
    expected = plain_values(maze, chaser, evader, 0.6)
    np.testing.assert_allclose(solution.values, expected, atol=1e-9)
    # Each policy stays within its mask, up to actions that lead to the same cell.
    after = maze.neighbors[:, :actions]
    apart = ~np.eye(maze.num_cells, dtype=bool)
    for policy, mask in ((solution.chaser_policy, chaser), (solution.evader_policy, evader)):
        np.testing.assert_allclose(policy.sum(axis=2), 1.0)
        for own, other, action in np.argwhere(policy > 0.0):
            if apart[own, other]:
                same = after[own] == after[own, action]
                assert (mask[own, other] & same).any()


def test_all_actions_allowed_is_the_full_game() -> None:
    every = np.ones((25, 25, 4), dtype=bool)
    for name in ("5x5-tree", "5x5-open"):
        full = solve_chase(load_maze(name))
        restricted = solve_chase(load_maze(name), allowed=(every, every))
        np.testing.assert_array_equal(full.values, restricted.values)
        np.testing.assert_array_equal(full.chaser_policy, restricted.chaser_policy)
        np.testing.assert_array_equal(full.evader_policy, restricted.evader_policy)


def test_invalid_masks() -> None:
    maze = load_maze("2x2")
    every = np.ones((4, 4, 4), dtype=bool)
    none = every.copy()
    none[1, 2] = False
    with pytest.raises(ValueError, match="chaser has no action with its own cell 1 and the other"):
        solve_chase(maze, allowed=(none, every))
    with pytest.raises(ValueError, match="evader has shape"):
        solve_chase(maze, allowed=(every, every[:3]))
    with pytest.raises(ValueError, match="give masks of booleans"):
        solve_chase(maze, allowed=(every, every.astype(float)))
    with pytest.raises(ValueError, match="num_chasers=2"):
        solve_chase(maze, num_chasers=2, allowed=(every, every))


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("maze", MAZES, ids=lambda maze: maze.name)
def test_ends_at_the_value_of_the_game(maze: Maze, order: MoveOrder) -> None:
    found = double_oracle(maze, move_order=order)
    game = solve_chase(maze, move_order=order)
    np.testing.assert_allclose(found.solution.values, game.values, atol=1e-6)
    tables = found.solution.chaser_policy, found.solution.evader_policy
    last = found.iterations[-1]
    assert last.nash_conv == pytest.approx(
        duel_nash_conv(maze, *tables, move_order=order), abs=1e-9
    )
    assert last.nash_conv <= last.largest_gain + 1e-9 and last.largest_gain <= 1e-6
    assert all(one.largest_gain > 1e-6 for one in found.iterations[:-1])
    assert len(found.chasers) == len(found.evaders) == last.policies == len(found.iterations)


def test_restricted_games_grow() -> None:
    """In 5x5-open with chasers first optimal play is random, so several policies are needed."""
    seen: list[int] = []
    found = double_oracle(
        "5x5-open", move_order="chasers_first", report=lambda one: seen.append(one.policies)
    )
    sizes = [one.chaser_actions + one.evader_actions for one in found.iterations]
    assert seen == list(range(1, len(sizes) + 1)) and len(sizes) > 3
    assert sizes == sorted(set(sizes)) and sizes[0] == 2.0
    game = solve_chase(load_maze("5x5-open"), move_order="chasers_first")
    assert game.mixed.any()


def test_tolerance_below_the_accuracy_of_best_responses() -> None:
    found = double_oracle("5x5-open", move_order="chasers_first", tolerance=1e-300)
    assert found.iterations[-1].largest_gain < 1e-7
    with pytest.raises(ValueError, match="tolerance=0"):
        double_oracle("3x3", tolerance=0)
    with pytest.raises(ValueError, match=r"discount=1\.0"):
        double_oracle("3x3-tree", discount=1.0)
