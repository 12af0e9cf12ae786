"""Compiled kernels of zero-sum games: matrix games, and Shapley's sweeps over all places.

A *place* of the chase is (team, evader cell), where `team` numbers the cells of all chasers, the
last one counting fastest. A *joint* action numbers the actions of all chasers likewise. Actions
that lead where an earlier action leads are left out of the matrices.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import allocating, compiled

SADDLE = 1e-12
"""Relative difference below which the pure maximin and minimax count as equal."""

MIXED = 1e-7
"""Difference in steps above which optimal play must be random; the values are that exact."""

SMALLEST_PIVOT = 1e-11
BLAND_AFTER = 40
"""Pivots by the largest coefficient; from then on by Bland's rule (1977), which cannot cycle."""


@compiled
def solve_matrix(payoff: Any, tableau: Any, basis: Any, row: Any, column: Any) -> Any:
    """Solve the game in which the row player gets, and the column player pays, `payoff`.

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

    last = n + m
    for i in range(m):
        for j in range(n):
            tableau[i, j] = (payoff[i, j] - lowest) / span + 1.0
        for j in range(m):
            tableau[i, n + j] = 1.0 if i == j else 0.0
        tableau[i, last] = 1.0
        basis[i] = n + i
    for j in range(last + 1):
        tableau[m, j] = -1.0 if j < n else 0.0
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
            if tableau[i, entering] > SMALLEST_PIVOT:
                mine = tableau[i, last] / tableau[i, entering]
                if mine < ratio or (mine == ratio and basis[i] < basis[leaving]):
                    leaving, ratio = i, mine
        if leaving < 0:
            break
        divisor = tableau[leaving, entering]
        for j in range(last + 1):
            tableau[leaving, j] /= divisor
        for i in range(m + 1):
            factor = tableau[i, entering]
            if i != leaving and factor != 0.0:
                for j in range(last + 1):
                    tableau[i, j] -= factor * tableau[leaving, j]
        basis[leaving] = entering
    total_row, total_column = 0.0, 0.0
    for i in range(m):
        row[i] = max(tableau[m, n + i], 0.0)
        total_row += row[i]
        if basis[i] < n:
            column[basis[i]] = max(tableau[i, last], 0.0)
            total_column += column[basis[i]]
    for i in range(m):
        row[i] /= total_row
    for j in range(n):
        column[j] /= total_column
    return (1.0 / tableau[m, last] - 1.0) * span + lowest, upper - lower


@compiled
def is_caught(
    cells: Any, neighbors: Any, joint: int, actions: int, evader: int, flight: int, first: bool
) -> Any:
    """Whether a chaser at `cells` catches the evader that moves to `flight` meanwhile.

    Together in one cell, or past each other; if the chasers move `first`, one that reaches the
    evader's cell has it before it leaves.
    """
    for i in range(len(cells) - 1, -1, -1):
        mine = neighbors[cells[i], joint % actions]
        joint //= actions
        if mine == flight or (mine == evader and (first or flight == cells[i])):
            return True
    return False


@compiled
def follow(cells: Any, neighbors: Any, joint: int, actions: int) -> Any:
    """The number of the team after a joint action."""
    team, scale = 0, 1
    for i in range(len(cells) - 1, -1, -1):
        team += scale * neighbors[cells[i], joint % actions]
        scale *= neighbors.shape[0]
        joint //= actions
    return team


@compiled
def is_useful(cells: Any, useful: Any, joint: int, actions: int) -> Any:
    """Whether every chaser's part of the joint action is one of its distinct moves."""
    for i in range(len(cells) - 1, -1, -1):
        if not useful[cells[i], joint % actions]:
            return False
        joint //= actions
    return True


@allocating
def shapley(
    values: Any,
    target: Any,
    teams: Any,
    neighbors: Any,
    useful: Any,
    discount: float,
    chasers_first: bool,
    chaser_policy: Any,
    evader_policy: Any,
    mixed: Any,
    first: int,
    last: int,
) -> Any:
    """One sweep of Shapley's iteration (1953) over the teams from `first` to `last` - 1.

    target = 1 + discount * the value of the matrix game over `values` at the next places.

    Args:
        values, target: [teams, cells] float64, expected discounted steps until capture.
        teams: [teams, chasers] int32, the cells of every team.
        neighbors: [cells, actions] int32.
        useful: [cells, actions] bool, False for an action that leads where an earlier one does.
        chaser_policy: [teams, cells, joint actions] float64, written.
        evader_policy: [teams, cells, actions] float64, written.
        mixed: [teams, cells] bool, written: whether there is no pure saddle point.

    Returns:
        The largest change.
    """
    size, actions = neighbors.shape
    joints = chaser_policy.shape[2]
    payoffs = np.empty((actions, joints))
    tableau = np.empty((actions + 1, joints + actions + 1))
    basis = np.empty(actions, dtype=np.int64)
    row, column = np.empty(actions), np.empty(joints)
    flights = np.empty(actions, dtype=np.int64)
    chases = np.empty(joints, dtype=np.int64)
    nexts = np.empty(joints, dtype=np.int64)
    change = 0.0
    for team in range(first, last):
        cells = teams[team]
        n = 0
        for joint in range(joints):
            if is_useful(cells, useful, joint, actions):
                chases[n], nexts[n] = joint, follow(cells, neighbors, joint, actions)
                n += 1
        for evader in range(size):
            together = False
            for cell in cells:
                together |= cell == evader
            if together:
                target[team, evader] = 0.0
                continue
            m = 0
            for action in range(actions):
                if useful[evader, action]:
                    flights[m] = action
                    m += 1
            for i in range(m):
                flight = neighbors[evader, flights[i]]
                for j in range(n):
                    caught = is_caught(
                        cells, neighbors, chases[j], actions, evader, flight, chasers_first
                    )
                    payoffs[i, j] = 0.0 if caught else values[nexts[j], flight]
            value, apart = solve_matrix(payoffs[:m, :n], tableau, basis, row[:m], column[:n])
            value = 1.0 + discount * value
            change = max(change, abs(value - values[team, evader]))
            target[team, evader], mixed[team, evader] = value, apart > MIXED
            chaser_policy[team, evader, :] = 0.0
            evader_policy[team, evader, :] = 0.0
            for i in range(m):
                evader_policy[team, evader, flights[i]] = row[i]
            for j in range(n):
                chaser_policy[team, evader, chases[j]] = column[j]
    return change


@compiled
def evaluate(
    values: Any,
    teams: Any,
    neighbors: Any,
    discount: float,
    chasers_first: bool,
    chaser_policy: Any,
    evader_policy: Any,
    tolerance: float,
    sweeps: int,
) -> None:
    """Move `values` to those of two fixed policies, in place, until changes are below `tolerance`.

    At most `sweeps` sweeps. The arrays are those of `shapley`.
    """
    size, actions = neighbors.shape
    joints = chaser_policy.shape[2]
    for _ in range(sweeps):
        change = 0.0
        for team in range(values.shape[0]):
            cells = teams[team]
            for evader in range(size):
                if values[team, evader] == 0.0:  # together
                    continue
                mean = 0.0
                for joint in range(joints):
                    share = chaser_policy[team, evader, joint]
                    if share == 0.0:
                        continue
                    following = follow(cells, neighbors, joint, actions)
                    for action in range(actions):
                        weight = share * evader_policy[team, evader, action]
                        if weight == 0.0:
                            continue
                        flight = neighbors[evader, action]
                        caught = is_caught(
                            cells, neighbors, joint, actions, evader, flight, chasers_first
                        )
                        if not caught:
                            mean += weight * values[following, flight]
                value = 1.0 + discount * mean
                change = max(change, abs(value - values[team, evader]))
                values[team, evader] = value
        if change <= tolerance:
            return
