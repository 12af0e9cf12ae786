"""Compiled kernels of zero-sum games: matrix games, and sweeps over all states of a game."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import allocating, compiled, inlined
from scripted_agents.exact.joint.layout import Store
from scripted_agents.exact.joint.slips import slip_options

SADDLE = 1e-12
"""Relative difference below which the pure maximin and minimax count as equal."""

SMALLEST_PIVOT = 1e-11

LARGEST_GAP = 1e-9
"""Share of the span of the payoffs by which the two strategies may miss each other's guarantee."""

ATTEMPTS, PERTURBED, PERTURBATION = 3, 2, 1e-8
"""Ways of choosing pivots, the last one of a perturbed game."""

BLAND_AFTER = 40
"""Pivots by the largest coefficient; from then on by Bland's rule (1977), which cannot cycle."""


@inlined
def pivot(tableau: Any, rows: int, last: int, entering: int, leaving: int) -> None:
    """One pivot of the simplex method: the row `leaving` solved for the column `entering`."""
    divisor = tableau[leaving, entering]
    for j in range(last + 1):
        tableau[leaving, j] /= divisor
    for i in range(rows + 1):
        factor = tableau[i, entering]
        if i != leaving and factor != 0.0:
            for j in range(last + 1):
                tableau[i, j] -= factor * tableau[leaving, j]


@inlined
def write_first_tableau(
    payoff: Any, lowest: float, span: float, perturbed: bool, tableau: Any, basis: Any
) -> None:
    """The tableau in which the slack variables are the basis; `perturbed`: of a game with payoffs
    that differ by up to `PERTURBATION` of their span, which is not degenerate."""
    m, n = payoff.shape
    last = n + m
    for i in range(m):
        for j in range(n):
            tableau[i, j] = (payoff[i, j] - lowest) / span + 1.0
            if perturbed:
                tableau[i, j] += PERTURBATION * (0.6180339887 * (i * n + j + 1) % 1.0)
        for j in range(m):
            tableau[i, n + j] = 1.0 if i == j else 0.0
        tableau[i, last] = 1.0
        basis[i] = n + i
    for j in range(last + 1):
        tableau[m, j] = -1.0 if j < n else 0.0


@compiled
def solve_matrix(payoff: Any, tableau: Any, basis: Any, row: Any, column: Any) -> Any:
    """Solve the zero-sum game with the payoff `payoff` of the row player.

    A pure saddle point is taken where there is one. Otherwise the linear program of the column
    player (Dantzig, 1951) by the simplex method: maximise the sum of w >= 0 under B w <= 1, where B
    is the payoff moved and scaled into [1, 2]; its duals are the row player's strategy.

    Args:
        payoff: [m, n] float64.
        tableau: [at least m + 1, at least n + m + 1] float64, scratch.
        basis: [at least m] int64, scratch.
        row, column: [m] and [n] float64, where to write the strategies.

    Returns:
        The value, and by how much the pure minimax is above the pure maximin.
    """
    m, n = payoff.shape
    lowest, highest = payoff[0, 0], payoff[0, 0]
    lower, upper = -np.inf, np.inf
    best_row, best_column = 0, 0
    for i in range(m):
        least = np.inf
        for j in range(n):
            least = min(least, payoff[i, j])
            highest = max(highest, payoff[i, j])
        lowest = min(lowest, least)
        if least > lower:
            lower, best_row = least, i
    for j in range(n):
        most = -np.inf
        for i in range(m):
            most = max(most, payoff[i, j])
        if most < upper:
            upper, best_column = most, j
    row[:] = 0.0
    column[:] = 0.0
    span = highest - lowest
    if upper - lower <= SADDLE * max(abs(lowest), abs(highest)):
        row[best_row], column[best_column] = 1.0, 1.0
        return lower, upper - lower

    # Degenerate games, with many nearly equal payoffs, can defeat the first way of choosing pivots.
    value, gap = lower, np.inf
    for attempt in range(ATTEMPTS):
        write_first_tableau(payoff, lowest, span, attempt == PERTURBED, tableau, basis)
        optimize(tableau, m, n, attempt > 0, basis)
        write_strategies(tableau, basis, row, column)
        value = (1.0 / tableau[m, n + m] - 1.0) * span + lowest
        least, most = guarantees(payoff, row, column)
        gap = most - least
        if abs(gap) <= LARGEST_GAP * span:  # not for NaN
            break
        value = 0.5 * (least + most)
    return value, upper - lower


@inlined
def optimize(tableau: Any, m: int, n: int, careful: bool, basis: Any) -> None:
    """Pivots until no coefficient is negative; `careful`: of nearly equal ratios the largest
    pivot."""
    last = n + m
    smallest = 1e-9 if careful else SMALLEST_PIVOT
    for pivots in range(100 * (m + n)):
        entering = -1
        least = -SMALLEST_PIVOT
        for j in range(last):
            if tableau[m, j] < least:
                entering = j
                if pivots >= BLAND_AFTER:
                    break
                least = tableau[m, j]
        if entering < 0:
            break
        leaving, ratio = -1, np.inf
        for i in range(m):
            if tableau[i, entering] > smallest:
                mine = tableau[i, last] / tableau[i, entering]
                if careful and leaving >= 0 and abs(mine - ratio) <= SADDLE:
                    better = tableau[i, entering] > tableau[leaving, entering]
                else:
                    better = mine < ratio or (mine == ratio and basis[i] < basis[leaving])
                if better:
                    leaving, ratio = i, mine
        if leaving < 0:
            break
        pivot(tableau, m, last, entering, leaving)
        basis[leaving] = entering


@inlined
def write_strategies(tableau: Any, basis: Any, row: Any, column: Any) -> None:
    """The strategies of an optimal tableau."""
    m, n = row.shape[0], column.shape[0]
    column[:] = 0.0
    total_row, total_column = 0.0, 0.0
    for i in range(m):
        row[i] = max(tableau[m, n + i], 0.0)
        total_row += row[i]
        if basis[i] < n:
            column[basis[i]] = max(tableau[i, n + m], 0.0)
            total_column += column[basis[i]]
    for i in range(m):
        row[i] /= total_row
    for j in range(n):
        column[j] /= total_column


@inlined
def guarantees(payoff: Any, row: Any, column: Any) -> tuple[float, float]:
    """What `row` gets at least, and `column` concedes at most."""
    m, n = payoff.shape
    least, most = np.inf, -np.inf
    for j in range(n):
        total = 0.0
        for i in range(m):
            total += row[i] * payoff[i, j]
        least = min(least, total)
    for i in range(m):
        total = 0.0
        for j in range(n):
            total += payoff[i, j] * column[j]
        most = max(most, total)
    return least, most


@allocating
def sweep_games(
    values: Any, target: Any, store: Store, discount: float, least_mixed: float, chances: Any,
    mixed: Any, first: int, last: int,
) -> Any:  # fmt: skip
    """One sweep of Shapley's iteration (1953) over the states from `first` to `last` - 1.

    target = the value of the matrix game over the immediate rewards and `discount` * the values of
    the next states.

    Args:
        values, target: [states] float64.
        store: what follows each state, the options of the row player counting slowest.
        least_mixed: difference of minimax and maximin above which there is no pure saddle point.
        chances: [pairs] float64, written: the chance of each pair of choices.
        mixed: [states] bool, written: whether there is no pure saddle point.

    Returns:
        The largest change.
    """
    most_rows: Any = 1
    most_columns: Any = 1
    for state in range(first, last):
        m = np.int64(store.shape[state, 2])
        most_rows = max(most_rows, m)
        most_columns = max(most_columns, store.shape[state, 0] // max(m, 1))
    payoffs = np.empty((most_rows, most_columns))
    tableau = np.empty((most_rows + 1, most_columns + most_rows + 1))
    basis = np.empty(most_rows, dtype=np.int64)
    worth = np.empty((most_rows * most_columns, 1))
    row, column = np.empty(most_rows), np.empty(most_columns)
    change = 0.0
    for state in range(first, last):
        m, pair, edge = np.int64(store.shape[state, 2]), store.pairs[state], store.edges[state]
        if m == 0:
            continue
        n = store.shape[state, 0] // m
        share = discount if store.shape[state, 3] != 0 else 1.0
        for at in range(m * n):
            after = store.following[pair + at]
            worth[at, 0] = store.sides[edge + at]
            if after >= 0:
                worth[at, 0] += share * values[after]
        if store.slips.shape[0] > 0:
            slip_options(store, state, worth, False)
        for i in range(m):
            for j in range(n):
                payoffs[i, j] = worth[i * n + j, 0]
        value, apart = solve_matrix(payoffs[:m, :n], tableau, basis, row[:m], column[:n])
        change = max(change, abs(value - values[state]))
        target[state], mixed[state] = value, apart > least_mixed
        for i in range(m):
            for j in range(n):
                chances[pair + i * n + j] = row[i] * column[j]
    return change


@compiled
def fill_strategies(store: Store, chances: Any, rows: Any, columns: Any) -> None:
    """Fill what both play, `rows` and `columns` [states, actions], from the `chances` of pairs."""
    for state in range(rows.shape[0]):
        pair, edge = store.pairs[state], store.edges[state]
        for at in range(store.shape[state, 0]):
            joint = np.int64(store.joints[edge + at])
            rows[state, joint // columns.shape[1]] += chances[pair + at]
            columns[state, joint % columns.shape[1]] += chances[pair + at]
