"""The script that makes the rows of the results page on options of the rules."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyses import script

from pursuit.mazes.generation import generate_graph
from pursuit.mazes.maze import Maze, load_maze
from pursuit.tasks.task import Task
from scripted_agents import (
    solve_chase,
    solve_in_turns,
    solve_joint,
    solve_joint_game,
    solve_matrix_game,
)
from scripted_agents.exact.joint.equilibrium import team_chase_game
from scripted_agents.exact.joint.shapley_iteration import solve_infinite_horizon
from scripted_agents.exact.joint.sweeps import Quantity

made = script("rules", "make_rows")
RULES = made.RULES


def chase(maze: str, rule: str, chasers: int) -> Task:
    return Task(maze=maze, num_chasers=chasers, num_evaders=1, stay_action=True, **RULES[rule])


def sure(*games: list[list[int]]) -> list[bool]:
    """The states, each [rows, columns] of next states, from which the column player ends surely."""
    shape = np.array([[np.size(game), 0, len(game), 1] for game in games], dtype=np.int32)
    pairs = np.cumsum([0, *shape[:, 0]])
    found = np.ones(len(games), dtype=bool)
    following = np.concatenate([np.ravel(game) for game in games]).astype(np.int32)
    made.find_sure_states(following, pairs, shape, found, np.zeros_like(found))
    return found.tolist()


def test_a_mixed_strategy_ends_surely_where_no_pure_one_does() -> None:
    """Matching pennies, in which a mismatch repeats the game, or is lost for good; and "hide or
    run", whose value is 1 without a strategy that ends surely (de Alfaro et al., 2007)."""
    lost = [[1]]
    assert sure([[-1, 0], [0, -1]], lost) == [True, False]
    assert sure([[-1, 1], [1, -1]], lost) == [False, False]
    assert sure([[0, -1], [-1, 1]], lost) == [False, False]
    assert sure([[2, 1]], lost, [[-1]]) == [True, False, True]


@pytest.mark.parametrize("rule", [rule for rule in RULES if "block" not in rule])
@pytest.mark.parametrize("maze", ["3x3", "3x3-open"])
def test_two_ways_to_solve_the_game_in_turns_agree(maze: str, rule: str) -> None:
    teams, rounds = made.capture_in_turns(load_maze(maze), 2, rule)
    apart = (teams[:, :1] != teams[:, 1:]) & (teams[:, :, None] != np.arange(9)).all(axis=1)
    forced, values = made.solved(replace(chase(maze, rule, 2), move_order="turns"))
    wanted = np.where(rounds > 0, (1.0 - 0.95**rounds) / 0.05, 20.0)[apart]
    np.testing.assert_allclose(np.sort(np.tile(wanted, 2)), np.sort(values), atol=1e-8)
    assert forced == pytest.approx((rounds[apart] > 0).mean())


def test_plain_rules_give_the_results_of_the_other_solvers() -> None:
    maze = load_maze("3x3")
    teams, rounds = made.capture_in_turns(maze, 2, "cell")
    times = solve_in_turns(maze, 2).times
    assert times is not None
    apart = (teams[:, :, None] != np.arange(9)).all(axis=1)
    wanted = times[tuple(teams.T)].astype(int)
    np.testing.assert_array_equal(rounds[apart], wanted[apart])
    _, values = made.solved(chase("3x3", "cell", 2))
    chased = solve_chase(maze, stay_action=True, num_chasers=2)
    assert values.mean() == pytest.approx(chased.mean_over_starts, abs=1e-8)


def after_moves(maze: Maze, cells: tuple[int, ...], rule: str, actions: Any) -> Any:
    """The cells of two chasers and an evader after a step, written from the text of the rules; None
    after a capture."""
    options = RULES[rule]
    target = [
        int(maze.neighbors[cell, action]) for cell, action in zip(cells, actions, strict=True)
    ]
    after = list(target)
    if options.get("collisions") == "block":
        for i in range(3):
            others = [j for j in range(3) if j != i]
            if target[i] in [c for j in others for c in (cells[j], target[j])]:
                after[i] = cells[i]
    *chasers, evader = after
    ways = {int(cell) for cell in maze.neighbors[evader, :4]} - {evader}
    swaps = [(after[i], cells[i]) == (cells[2], after[2]) for i in range(2)]
    if options.get("capture") == "surround":
        over = ways <= set(chasers)
    elif options.get("capture") == "adjacent":
        over = any(chaser in ways | {evader} for chaser in chasers)
    else:
        met = [c == evader or swap for c, swap in zip(chasers, swaps, strict=True)]
        over = sum(met) >= options.get("n_catch", 1)
    return None if over else tuple(after)


@pytest.mark.parametrize("rule", RULES)
def test_the_value_of_moves_at_once_is_that_of_brute_force(rule: str) -> None:
    """Shapley's iteration over all cells, one matrix game after the other."""
    maze, cells = load_maze("2x2-open"), list(product(range(4), repeat=3))
    follows = {
        now: [
            [
                after_moves(maze, now, rule, (*chasers, evader))
                for chasers in product(range(5), repeat=2)
            ]
            for evader in range(5)
        ]
        for now in cells
    }
    values: dict[Any, float] = dict.fromkeys([*cells, None], 0.0)
    for _ in range(150):
        before = values
        values = {None: 0.0}
        for now, table in follows.items():
            payoff = [[1.0 + 0.95 * before[after] for after in row] for row in table]
            values[now] = solve_matrix_game(payoff).value
    _, found = made.solved(chase("2x2-open", rule, 2))
    starts = [values[now] for now in cells if len(set(now)) == 3]
    bound = 20.0 * 0.95**150 + 1e-9
    assert found.mean() == pytest.approx(np.mean(starts), abs=bound)
    assert found.mean() >= np.mean(starts) - 1e-9


def test_the_payoff_can_be_any_reward() -> None:
    task = Task(
        maze="3x3", num_chasers=1, num_evaders=1, exits=[5], rewards="win_loss", stay_action=True
    )
    game, twins = team_chase_game(task, Quantity([0, 1], [0, 0]), 0.9)
    values, _ = solve_infinite_horizon(game)
    lead = solve_joint_game(task, 0.9)
    np.testing.assert_allclose(-2.0 * values[twins], lead.values, atol=1e-7)


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("prey_moves", [4, 5])
def test_relative_cells_lose_nothing(order: str, prey_moves: int) -> None:
    """Two predators next to the prey on a torus, against all states of the game."""
    task = Task(
        maze=generate_graph("torus", 4, 4), num_chasers=2, num_evaders=1, stay_action=True,
        capture="adjacent", n_catch=2, collisions="block", move_order=order,
    )  # fmt: skip
    whole = solve_joint(task, "chaser", {"evader": made.prey_table(16, prey_moves)}, None)
    reduced = made.least_mean_steps(4, 2, 2, order, prey_moves)
    assert reduced.mean() == pytest.approx(whole.mean_over_starts, abs=1e-8)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("capture", ("3x3", "surround", "2")),
        ("capture", ("3x3-open", "surround, block", "2")),
        ("escape", ("1", "2")),
    ],
)
def test_a_row_is_computed_as_it_stands_in_its_file(
    name: str, key: tuple[str, ...], tmp_path: Path
) -> None:
    found, kept = (made.add_row(folder, name, key) for folder in (tmp_path, made.OUT))
    assert {**found, "seconds": ""} == {**kept, "seconds": ""}
    assert made.read(tmp_path / f"{name}.csv") == [found]


def test_the_files_have_all_rows_and_only_these() -> None:
    rows = [
        (name, tuple(row[part] for part in made.COLUMNS[name][1].split()))
        for name in made.COLUMNS
        for row in made.read(made.OUT / f"{name}.csv")
    ]
    assert sorted(rows) == sorted(made.keys())
    assert set(made.keys(short=True)) < set(rows)
