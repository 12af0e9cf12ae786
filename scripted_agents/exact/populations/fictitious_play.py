"""Fictitious play with exact best responses, in matrix games and in duels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.validation import whole
from scripted_agents.exact.duel.best_response import MoveOrder, best_response, mean_over_starts
from scripted_agents.exact.joint.equilibrium import payoff_matrix
from scripted_agents.exact.populations.uniform import uniform_duel_table


@dataclass(frozen=True, eq=False)
class MatrixPlay:
    """The result of `matrix_fictitious_play`.

    Attributes:
        row, column: [m] and [n] float64, the average strategies.
        nash_convs: [iterations] float64, of the averages after each iteration, in payoffs. The
            value of the game differs from row @ payoff @ column by at most the last one.
    """

    row: NDArray[np.float64]
    column: NDArray[np.float64]
    nash_convs: NDArray[np.float64] = field(repr=False)


def matrix_fictitious_play(payoff: ArrayLike, iterations: int = 1000) -> MatrixPlay:
    """Fictitious play in a zero-sum matrix game: best responses to averages. Brown (1951).

    In each iteration both players take the first best response to the average strategy of the
    other; the first iteration takes the first row and column.

    NashConv goes to 0 (Robinson, 1951). Karlin's conjecture (1959) of a rate of O(T^-1/2) for T
    iterations holds in many games but not in all: Daskalakis and Pan (2014) disprove it for some
    rules for ties, Wang (2025) without ties.

    Args:
        payoff: [m, n], the payoff of the row player, which maximises.
        iterations: their number, at least 1.

    Raises:
        ValueError: as `solve_matrix_game`, or fewer than 1 iteration.
    """
    matrix, iterations = payoff_matrix(payoff), whole("iterations", iterations, 1)
    rows, columns = (np.zeros(many) for many in matrix.shape)
    of_rows, of_columns = np.zeros_like(rows), np.zeros_like(columns)  # sums of payoffs so far
    nash_convs = np.empty(iterations)
    for number in range(iterations):
        row, column = int(of_rows.argmax()), int(of_columns.argmin())
        rows[row] += 1.0
        columns[column] += 1.0
        of_rows += matrix[:, column]
        of_columns += matrix[row]
        nash_convs[number] = (of_rows.max() - of_columns.min()) / (number + 1)
    return MatrixPlay(rows / iterations, columns / iterations, nash_convs)


@dataclass(frozen=True, eq=False)
class FictitiousPlay:
    """The result of `fictitious_play`.

    Attributes:
        chaser_policy, evader_policy: [own cell, other cell, action] float64, the last averages.
        nash_convs: [iterations] float64, of the averages of each iteration, the last ones are
            the result: discounted steps, the mean over all starts in distinct cells.
    """

    chaser_policy: NDArray[np.float64] = field(repr=False)
    evader_policy: NDArray[np.float64] = field(repr=False)
    nash_convs: NDArray[np.float64] = field(repr=False)


def fictitious_play(
    maze: Maze | str,
    iterations: int = 1000,
    discount: float = 0.95,
    stay_action: bool = False,
    move_order: MoveOrder = "simultaneous",
    report: Callable[[int, float], None] = lambda number, nash_conv: None,
) -> FictitiousPlay:
    """Fictitious play in a duel: exact best responses to averages in every state.

    In each iteration both sides find their exact best response to the average of the other, and
    the averages of both move towards it by 1 / t at every pair of cells. The first policies are
    uniformly random.

    What is guaranteed: NashConv of every average is exact, so it bounds the error. That it goes to
    0 is not known for these updates. It is proven if best responses are those of the stage game
    with values that change more slowly than the policies (Leslie, Perkins and Xu, 2020; Sayin,
    Parise and Ozdaglar, 2022), and in matrix games (Robinson, 1951). In games that are not zero-sum
    fictitious play of stationary policies may not converge (Schoenmakers, Flesch and Thuijsman,
    2007). `double_oracle` and `solve_chase` end at the equilibrium.

    Args:
        maze, discount, stay_action, move_order: as for `solve_chase`.
        iterations: their number, at least 1.
        report: called with the number of each iteration, from 1, and the NashConv of its averages.

    Raises:
        ValueError: an argument outside these limits, or as `best_response`.
    """
    maze, iterations = load_maze(maze), whole("iterations", iterations, 1)
    chaser, evader = (uniform_duel_table(maze, discount, stay_action) for _ in range(2))
    rest = (None, discount, stay_action, move_order)
    nash_convs = np.empty(iterations)
    for number in range(1, iterations + 1):
        longest = best_response("evader", maze, chaser, *rest)
        shortest = best_response("chaser", maze, evader, *rest)
        nash_convs[number - 1] = mean_over_starts(longest.values - shortest.values, maze)
        report(number, nash_convs[number - 1])
        if number < iterations:
            chaser += (shortest.policy - chaser) / (number + 1)
            evader += (longest.policy - evader) / (number + 1)
    return FictitiousPlay(chaser, evader, nash_convs)
