"""PSRO on payoff matrices: meta-strategies over populations, and the loop of best responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.validation import number, one_of
from scripted_agents.exact.joint.equilibrium import payoff_matrix, solve_matrix_game
from scripted_agents.exact.limits import MAX_PROFILES
from scripted_agents.exact.tolerances import TIE

MetaKind = Literal["nash", "uniform", "alpha-rank"]

MUTATION = 0.01
"""Probability that a worse strategy replaces a better one in alpha-rank: OpenSpiel's default."""

Strategy = NDArray[np.float64]


def meta_strategy(payoff: ArrayLike, kind: MetaKind = "nash") -> tuple[Strategy, Strategy]:
    """The mixtures over two populations by which PSRO draws opponents (Lanctot et al., 2017).

    Kinds:
        "nash": an equilibrium of the matrix game, as in double oracle (McMahan et al., 2003).
        "uniform": all members equally, as in fictitious play.
        "alpha-rank": the marginals of alpha-rank (Omidshafiei et al., 2019; Muller et al., 2020,
            for PSRO) with infinite selection intensity: see `alpha_rank`.

    Args:
        payoff: [m, n], the payoff of the row player, which maximises; the game is zero-sum.
        kind: of the mixtures.

    Returns:
        [m] and [n] float64 of sum 1.

    Raises:
        ValueError: an unknown kind, or as `solve_matrix_game` and `alpha_rank`.
    """
    one_of("kind", kind, ("nash", "uniform", "alpha-rank"))
    matrix = payoff_matrix(payoff)
    if kind == "nash":
        game = solve_matrix_game(matrix)
        return game.row, game.column
    if kind == "uniform":
        m, n = matrix.shape
        return np.full(m, 1.0 / m), np.full(n, 1.0 / n)
    joint = alpha_rank(matrix)
    return joint.sum(axis=1), joint.sum(axis=0)


def alpha_rank(payoff: ArrayLike) -> NDArray[np.float64]:
    """Alpha-rank of a two-player zero-sum game, for infinite selection intensity.

    The stationary distribution of a Markov chain over pairs of pure strategies (Omidshafiei et al.,
    2019). In a step one player changes to another of its strategies, each of these (m - 1) +
    (n - 1) changes being proposed equally often. It is accepted with probability 1 - MUTATION if
    it is better for this player, 1/2 if equal, and MUTATION if worse (Rowland et al., 2019). So
    the result does not depend on the scale of payoffs.

    Args:
        payoff: [m, n], the payoff of the row player, which maximises.

    Returns:
        [m, n] float64 of sum 1, the probability of each pair.

    Raises:
        ValueError: as `solve_matrix_game`, or more than MAX_PROFILES pairs.
    """
    matrix = payoff_matrix(payoff)
    m, n = matrix.shape
    count = m * n
    if count > MAX_PROFILES:
        raise ValueError(
            f"payoff has shape {matrix.shape}, {count} pairs; alpha-rank solves at most "
            f"{MAX_PROFILES}. Give fewer strategies"
        )
    if count == 1:
        return np.ones((1, 1))
    close = TIE * float(np.abs(matrix).max())
    chain = np.zeros((m, n, m, n))
    rows, columns = np.arange(m), np.arange(n)
    # [i, j, k]: from the pair (i, j) to the row, or the column, k.
    chain[:, columns, :, columns] = _accepted(matrix.T[:, None, :] - matrix.T[:, :, None], close)
    by_column = _accepted(matrix[:, :, None] - matrix[:, None, :], close)
    chain[rows, :, rows, :] += by_column
    chain = chain.reshape(count, count) / (m + n - 2)
    np.fill_diagonal(chain, 0.0)
    np.fill_diagonal(chain, 1.0 - chain.sum(axis=1))
    # The distribution is x = x @ chain of sum 1: one equation is replaced by the sum.
    system = chain.T - np.eye(count)
    system[-1] = 1.0
    found = np.clip(np.linalg.solve(system, np.eye(count)[-1]), 0.0, None)
    joint: NDArray[np.float64] = (found / found.sum()).reshape(m, n)
    return joint


def _accepted(gain: NDArray[np.float64], close: float) -> NDArray[np.float64]:
    """The probability that a change with this gain is accepted."""
    return np.where(np.abs(gain) <= close, 0.5, np.where(gain > 0.0, 1.0 - MUTATION, MUTATION))


@dataclass(frozen=True, eq=False)
class PSRO:
    """The result of `psro`.

    Attributes:
        row, column: [m] and [n] float64, the last meta-strategies in the full game.
        rows, columns: the populations, in the order in which their members were added.
        nash_convs: of the meta-strategies of each iteration in the full game, in payoffs.
    """

    row: Strategy
    column: Strategy
    rows: list[int]
    columns: list[int]
    nash_convs: list[float]


def psro(payoff: ArrayLike, meta: MetaKind = "nash", tolerance: float = 1e-9) -> PSRO:
    """Policy-space response oracles with exact best responses on a matrix (Lanctot et al., 2017).

    The populations start with the first row and column. In each iteration the first best response
    of each player to the meta-strategy of the other joins its population, until NashConv is at most
    the tolerance or both are in the populations already. With "nash" this is double oracle
    (McMahan et al., 2003) and ends at an equilibrium; the other meta-strategies may end elsewhere.

    Args:
        payoff: [m, n], the payoff of the row player, which maximises.
        meta: as `kind` of `meta_strategy`.
        tolerance: at this NashConv it ends, in payoffs, at least 0.

    Raises:
        ValueError: as `meta_strategy`, or a tolerance below 0.
    """
    matrix = payoff_matrix(payoff)
    number("tolerance", tolerance, 0.0)
    rows, columns = [0], [0]
    nash_convs: list[float] = []
    while True:
        row, column = (np.zeros(many) for many in matrix.shape)
        row[rows], column[columns] = meta_strategy(matrix[np.ix_(rows, columns)], meta)
        of_rows, of_columns = matrix @ column, row @ matrix
        nash_convs.append(float(of_rows.max() - of_columns.min()))
        best_row, best_column = int(of_rows.argmax()), int(of_columns.argmin())
        new_rows = [best_row] if best_row not in rows else []
        new_columns = [best_column] if best_column not in columns else []
        if nash_convs[-1] <= tolerance or not new_rows + new_columns:
            return PSRO(row, column, rows, columns, nash_convs)
        rows += new_rows
        columns += new_columns
