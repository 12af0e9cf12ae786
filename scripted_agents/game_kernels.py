"""Compiled kernels of zero-sum games: matrix games, sweeps over all places of a chase.

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

SMALLEST_PIVOT = 1e-11
TIE = 1e-12
"""Relative difference below which two options count as equally good."""

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
def look(
    values: Any, following: int, before: Any, after: Any, evader: int, flight: int, first: bool
) -> Any:
    """The value of the next place, of chasers who move from `before` to `after`; 0 when caught.

    Places where a chaser stands on the evader have the value 0, so meeting in one cell needs no
    case of its own. Passing each other does, and, if the chasers move `first`, reaching the
    evader's cell before it leaves.
    """
    for i in range(len(before)):
        if after[i] == evader and (first or flight == before[i]):
            return 0.0
    return values[following, flight]


@compiled
def is_useful(cells: Any, useful: Any, joint: int, actions: int) -> Any:
    """Whether every chaser's part of the joint action is one of its distinct moves."""
    for i in range(len(cells) - 1, -1, -1):
        if not useful[cells[i], joint % actions]:
            return False
        joint //= actions
    return True


@compiled
def stands_on(cells: Any, evader: int) -> Any:
    """Whether a chaser stands in the evader's cell."""
    for cell in cells:
        if cell == evader:
            return True
    return False


@allocating
def shapley(
    values: Any,
    target: Any,
    teams: Any,
    nexts: Any,
    numbers: Any,
    neighbors: Any,
    useful: Any,
    discount: float,
    chasers_first: bool,
    least_mixed: float,
    chaser_policy: Any,
    evader_policy: Any,
    mixed: Any,
    first: int,
    last: int,
) -> Any:
    """One sweep of Shapley's iteration (1953) over the teams numbers[first] to numbers[last - 1].

    target = 1 + discount * the value of the matrix game over `values` at the next places.

    Args:
        values, target: [teams, cells] float64, expected discounted steps until capture.
        teams: [teams, chasers] int32, the cells of every team.
        nexts: [teams, joint actions] int32, the team after each joint action.
        numbers: [some teams] int64, those to look at.
        neighbors: [cells, actions] int32.
        useful: [cells, actions] bool, False for an action that leads where an earlier one does.
        least_mixed: difference of minimax and maximin above which there is no pure saddle point.
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
    change = 0.0
    for team in numbers[first:last]:
        cells = teams[team]
        n = 0
        for joint in range(joints):
            if is_useful(cells, useful, joint, actions):
                chases[n] = joint
                n += 1
        for evader in range(size):
            if stands_on(cells, evader):
                target[team, evader] = 0.0
                continue
            m = 0
            for action in range(actions):
                if useful[evader, action]:
                    flights[m] = action
                    m += 1
            for j in range(n):
                following = nexts[team, chases[j]]
                after = teams[following]
                for i in range(m):
                    flight = neighbors[evader, flights[i]]
                    payoffs[i, j] = look(
                        values, following, cells, after, evader, flight, chasers_first
                    )
            value, apart = solve_matrix(payoffs[:m, :n], tableau, basis, row[:m], column[:n])
            value = 1.0 + discount * value
            change = max(change, abs(value - values[team, evader]))
            target[team, evader], mixed[team, evader] = value, apart > least_mixed
            chaser_policy[team, evader, :] = 0.0
            evader_policy[team, evader, :] = 0.0
            for i in range(m):
                evader_policy[team, evader, flights[i]] = row[i]
            for j in range(n):
                chaser_policy[team, evader, chases[j]] = column[j]
    return change


@compiled
def count_following(
    teams: Any, nexts: Any, numbers: Any, neighbors: Any, chaser_policy: Any, evader_policy: Any
) -> Any:
    """How many entries `fill_following` needs, at most: pairs of actions that are played."""
    size, actions = neighbors.shape
    entries = 0
    for team in numbers:
        for evader in range(size):
            if stands_on(teams[team], evader):
                continue
            mine, theirs = 0, 0
            for joint in range(nexts.shape[1]):
                mine += chaser_policy[team, evader, joint] != 0.0
            for action in range(actions):
                theirs += evader_policy[team, evader, action] != 0.0
            entries += mine * theirs
    return entries


@compiled
def fill_following(
    teams: Any,
    nexts: Any,
    numbers: Any,
    places: Any,
    neighbors: Any,
    chasers_first: bool,
    chaser_policy: Any,
    evader_policy: Any,
    starts: Any,
    columns: Any,
    chances: Any,
) -> None:
    """The chances of the next places under two policies, as the rows of a sparse matrix.

    Row and column `places[team] * cells + evader`; captures lead nowhere.

    Args:
        teams, nexts, numbers, neighbors, chaser_policy, evader_policy: as in `shapley`.
        places: [teams] int64, the place in `numbers` of the team that is this one but for order.
        starts: [places + 1] int32, written: where each row begins.
        columns, chances: [entries] int32 and float64, written.
    """
    size, actions = neighbors.shape
    entry = 0
    for i in range(len(numbers)):
        team = numbers[i]
        cells = teams[team]
        for evader in range(size):
            starts[i * size + evader] = entry
            if stands_on(cells, evader):
                continue
            for joint in range(nexts.shape[1]):
                share = chaser_policy[team, evader, joint]
                if share == 0.0:
                    continue
                following = nexts[team, joint]
                after = teams[following]
                for action in range(actions):
                    chance = share * evader_policy[team, evader, action]
                    if chance == 0.0:
                        continue
                    flight = neighbors[evader, action]
                    caught = stands_on(after, flight)
                    for chaser in range(len(cells)):
                        caught |= after[chaser] == evader and (
                            chasers_first or flight == cells[chaser]
                        )
                    if not caught:
                        columns[entry] = places[following] * size + flight
                        chances[entry] = chance
                        entry += 1
    starts[len(numbers) * size] = entry


# -- one side against the other --------------------------------------------------------------------

CHASERS, EVADER = range(2)
"""Who chooses its actions in `respond`, as well as it can."""


@allocating
def respond(
    values: Any,
    target: Any,
    teams: Any,
    nexts: Any,
    numbers: Any,
    neighbors: Any,
    who: int,
    groups: Any,
    step_discount: float,
    chasers_first: bool,
    weights: Any,
    chances: Any,
    choice: Any,
    first: int,
    last: int,
) -> Any:
    """One step of backward induction (Bellman, 1957) over the teams of numbers[first:last].

    The evader chooses, or the chasers, some of them, or none; the others play by `weights` and
    `chances`.

    Args:
        values, target, teams, nexts, numbers, neighbors: as in `shapley`; target may be values.
        who: CHASERS or EVADER.
        groups: [joint actions] int64: what the choosing chasers decide of a joint action, counted
            from 0 (all 0: nothing); joint actions that agree in it are weighed by `weights`.
        step_discount: by which the values of the next places count.
        weights: [teams, cells, joint actions] float64, or [1, 1, joint actions] for all alike.
        chances: [teams, cells, actions] float64, of the evader; not looked at if it chooses.
        choice: [teams, cells] int16, written: the group, or the action of the evader, chosen.

    Returns:
        The largest change.
    """
    size, actions = neighbors.shape
    joints = nexts.shape[1]
    count = actions if who == EVADER else groups.max() + 1
    totals = np.empty(count)
    change = 0.0
    for team in numbers[first:last]:
        cells = teams[team]
        for evader in range(size):
            if stands_on(cells, evader):
                target[team, evader] = 0.0
                continue
            shares = weights[team % weights.shape[0], evader % weights.shape[1]]
            totals[:] = 0.0
            for joint in range(joints):
                share = shares[joint]
                if share == 0.0:
                    continue
                following = nexts[team, joint]
                after = teams[following]
                mean = 0.0
                for action in range(actions):
                    chance = 1.0 if who == EVADER else chances[team, evader, action]
                    if chance == 0.0:
                        continue
                    flight = neighbors[evader, action]
                    value = look(values, following, cells, after, evader, flight, chasers_first)
                    if who == EVADER:
                        totals[action] += share * value
                    else:
                        mean += chance * value
                if who != EVADER:
                    totals[groups[joint]] += share * mean
            best = 0
            for option in range(1, count):
                less = totals[best] - totals[option]
                gain = -less if who == EVADER else less
                if gain > TIE * abs(totals[best]):
                    best = option
            value = 1.0 + step_discount * totals[best]
            change = max(change, abs(value - values[team, evader]))
            target[team, evader], choice[team, evader] = value, best
    return change
