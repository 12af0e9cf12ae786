"""Fictitious play against the definition of NashConv, its rate in small games, and exact values."""

from __future__ import annotations

import numpy as np
import pytest

from pursuit.mazes.maze import load_maze
from scripted_agents import (
    best_response,
    evaluate_exactly,
    fictitious_play,
    matrix_fictitious_play,
    mean_over_starts,
    solve_chase,
    solve_matrix_game,
)
from train.evaluation.exploitability import duel_nash_conv

ROCK_PAPER_SCISSORS = [[0, -1, 1], [1, 0, -1], [-1, 1, 0]]
GAMES = [
    ROCK_PAPER_SCISSORS,
    [[0, -1, 2], [1, 0, -1], [-2, 1, 0]],
    [[1, -1], [-1, 1]],
    [[3.0, 1.0], [0.5, 2.0], [1.0, 1.0]],
    np.random.default_rng(0).normal(size=(5, 4)),
]


@pytest.mark.parametrize("payoff", GAMES)
def test_rate_in_matrix_games(payoff: object) -> None:
    """In these games NashConv stays below 3 * (largest - smallest payoff) / sqrt(iterations)."""
    matrix = np.array(payoff, dtype=float)
    found = matrix_fictitious_play(matrix, 20_000)
    bound = 3.0 * np.ptp(matrix) / np.sqrt(np.arange(1, 20_001))
    assert (found.nash_convs <= bound).all()
    # The last NashConv by definition; the value lies between the two best responses.
    highest, lowest = (matrix @ found.column).max(), (found.row @ matrix).min()
    assert found.nash_convs[-1] == pytest.approx(highest - lowest)
    assert lowest - 1e-12 <= solve_matrix_game(matrix).value <= highest + 1e-12


def test_first_iterations_by_hand() -> None:
    """Both play rock, then paper twice."""
    assert matrix_fictitious_play(ROCK_PAPER_SCISSORS, 1).row.tolist() == [1, 0, 0]
    third = matrix_fictitious_play(ROCK_PAPER_SCISSORS, 3)
    np.testing.assert_allclose(third.row, [1 / 3, 2 / 3, 0])
    np.testing.assert_allclose(third.column, third.row)
    # After the averages (1/3, 2/3, 0): scissors gets 1/3, so NashConv is 2/3.
    assert third.nash_convs[-1] == pytest.approx(2 / 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "iterations", "most"), [("5x5-tree", 300, 0.06), ("5x5", 300, 0.8)]
)
def test_nash_conv_in_duels(name: str, iterations: int, most: float) -> None:
    """Exact, and the values of the averages are within it of the value of the game."""
    maze = load_maze(name)
    told: list[tuple[int, float]] = []
    found = fictitious_play(maze, 300, report=lambda *one: told.append(one))
    tables = found.chaser_policy, found.evader_policy
    last = float(found.nash_convs[-1])
    assert told == list(enumerate(found.nash_convs, 1))
    assert last == pytest.approx(duel_nash_conv(maze, *tables), abs=1e-9)
    assert last < most and last < 0.1 * found.nash_convs[9]
    met = mean_over_starts(evaluate_exactly(maze, *tables, None, 0.95), maze)
    game = mean_over_starts(solve_chase(maze).values, maze)
    assert abs(met - game) <= last


def test_averages_by_definition() -> None:
    """The average of uniform and of the responses, each to the average before it."""
    maze = load_maze("3x3-tree")
    chaser = evader = np.full((9, 9, 5), 0.2)
    chasers, evaders = [chaser], [evader]
    for _ in range(4):
        answer = best_response("chaser", maze, evader, None, 0.9).policy
        evaders.append(best_response("evader", maze, chaser, None, 0.9).policy)
        chasers.append(answer)
        chaser, evader = np.mean(chasers, axis=0), np.mean(evaders, axis=0)
    found = fictitious_play(maze, 5, discount=0.9, stay_action=True)
    np.testing.assert_allclose(found.chaser_policy, chaser, atol=1e-12)
    np.testing.assert_allclose(found.evader_policy, evader, atol=1e-12)


def test_invalid_arguments() -> None:
    with pytest.raises(ValueError, match="iterations"):
        fictitious_play("3x3", 0)
    with pytest.raises(ValueError, match="discount=0"):
        fictitious_play("3x3", discount=0)
    with pytest.raises(ValueError, match="iterations"):
        matrix_fictitious_play([[1.0]], 0)
    with pytest.raises(ValueError, match="payoff has shape"):
        matrix_fictitious_play([1.0, 2.0])
