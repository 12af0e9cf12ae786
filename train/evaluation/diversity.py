"""Diversity of the snapshots of self-play in a duel: distances, effective number, cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.tasks.task import Task
from scripted_agents import evaluate_exactly, mean_over_starts, solve_matrix_game
from scripted_agents.exact.duel.action_values import outcomes
from scripted_agents.exact.duel.best_response import MoveOrder
from scripted_agents.exact.references import is_table_duel
from train.evaluation.games import order_of, table_in
from train.evaluation.ratings import pairwise_wins
from train.settings.self_play import OPPOSING_ROLES

PolicyTable = NDArray[np.float64]

MOST_SNAPSHOTS = 8
"""Snapshots per role, spread from the first to the last: each pair of them is solved exactly."""


Measures = dict[str, float | None]
"""Measures of the snapshots of one role.

"snapshots": their number. "distance": `mean_distance`, in [0, 1]. "effective_number": that of the
Nash mixture of the payoff matrix of all snapshots, from 1 to their number; the mixture is a vertex
of the set of equilibria, so copies of a policy count once. "cycles": `cyclic_share` of the triples,
in [0, 1]; None for fewer than three snapshots.
"""


def diversity(
    maze: Maze, chasers: PolicyTable, evaders: PolicyTable, discount: float, move_order: MoveOrder
) -> dict[str, Measures]:
    """The diversity of both populations by role, from all pairs of a chaser and an evader, exactly.

    Args:
        maze: of the duel.
        chasers, evaders: [snapshots, own cell, other cell, action] float64 probabilities, at least
            one of each.
        discount: of each step, in (0, 1).
        move_order: as in `Task`.

    Raises:
        ValueError: invalid tables or a discount, as `evaluate_exactly`.
    """
    count = len(chasers), len(evaders)
    payoff = np.empty(count)
    visits = np.empty((*count, maze.num_cells, maze.num_cells))
    for i, chaser in enumerate(chasers):
        for j, evader in enumerate(evaders):
            values = evaluate_exactly(maze, chaser, evader, None, discount, move_order)
            payoff[i, j] = mean_over_starts(values, maze)
            visits[i, j] = visited_states(maze, chaser, evader, discount, move_order)
    payoff = payoff.round(6)  # errors of the solver decide no comparison
    game = solve_matrix_game(payoff.T)  # the evaders maximise
    sides = {
        "chaser": (chasers, visits.mean(axis=1), game.column, -payoff),
        "evader": (evaders, visits.mean(axis=0).swapaxes(1, 2), game.row, payoff.T),
    }
    return {
        role: {
            "snapshots": len(tables),
            "distance": mean_distance(maze, tables, seen),
            "effective_number": effective_number(mixture),
            "cycles": cyclic_share(results),
        }
        for role, (tables, seen, mixture, results) in sides.items()
    }


def visited_states(
    maze: Maze, chaser: PolicyTable, evader: PolicyTable, discount: float, move_order: MoveOrder
) -> PolicyTable:
    """[chaser cell, evader cell] float64 of sum 1: the discounted distribution of visited states.

    Proportional to the expected sum of discount**t over the steps t = 0, 1, ... in which a game
    from a uniformly random start in distinct cells is in this state, before the capture (Puterman,
    1994, section 6.9).

    Args:
        maze, discount, move_order: as for `evaluate_exactly`.
        chaser, evader: [own cell, other cell, action].
    """
    from scipy.sparse import csc_array, eye_array  # slow to import
    from scipy.sparse.linalg import splu

    cells = maze.num_cells
    apart = ~np.eye(cells, dtype=bool)
    states = np.arange(cells**2).reshape(cells, cells)
    before, after, chances = [], [], []
    for action, chance, mine, theirs, caught in outcomes(
        "chaser", maze, evader, chaser.shape[2], move_order
    ):
        weight = chaser[:, :, action] * chance
        possible = apart & ~caught & (weight > 0.0)
        before.append(states[possible])
        after.append((mine * cells + theirs)[possible])
        chances.append(weight[possible])
    entries = np.concatenate(chances), (np.concatenate(after), np.concatenate(before))
    following = csc_array(entries, (cells**2, cells**2))
    factors = splu(csc_array(eye_array(cells**2) - discount * following))
    visits = factors.solve(apart.ravel().astype(np.float64))
    return np.asarray(visits / visits.sum()).reshape(cells, cells)


def mean_distance(maze: Maze, tables: PolicyTable, visits: PolicyTable) -> float:
    """The mean total variation distance between two different policies of one role.

    The distance of two policies in a state is half the sum of the absolute differences of the
    probabilities of their next cells, as actions that lead to the same cell do the same. States
    count by the mean of both policies' visits.

    Args:
        maze: of the duel.
        tables: [policies, own cell, other cell, action].
        visits: [policies, own cell, other cell] of sum 1 each.

    Returns:
        In [0, 1]; 0 for a single policy.
    """
    cells = maze.neighbors[:, : tables.shape[3]]
    same = (cells[:, :, None] == cells[:, None, :]).astype(np.float64)
    # [own cell, action, action]: each group of equal actions is counted at its first one.
    same *= same.argmax(axis=2)[:, :, None] == np.arange(tables.shape[3])[:, None]
    merged = np.einsum("nsoa,sba->nsob", tables, same)
    distances = [
        float((0.5 * np.abs(merged[i] - merged[k]).sum(axis=2) * (visits[i] + visits[k])).sum() / 2)
        for i, k in combinations(range(len(tables)), 2)
    ]
    return float(np.mean(distances)) if distances else 0.0


def effective_number(mixture: NDArray[np.float64]) -> float:
    """The exponential of the entropy of a mixture: n for n equal shares (Hill, 1973)."""
    shares = mixture[mixture > 0.0]
    return float(np.exp(-(shares * np.log(shares)).sum()))


def cyclic_share(results: NDArray[np.float64]) -> float | None:
    """The share of triples of players in which A is better than B, B than C and C than A.

    A player is better than another if it has the better result against more than half of the
    opponents, ties counting half, as in `pairwise_wins` of leagues.

    Args:
        results: [players, opponents], larger is better.

    Returns:
        In [0, 1], or None for fewer than three players.
    """
    count = len(results)
    if count < 3:
        return None
    better = (pairwise_wins(results[:, :, None])[:, :, 0] > 0.5).astype(np.int64)
    triples = count * (count - 1) * (count - 2) // 6
    return int(np.trace(better @ better @ better)) // 3 / triples


def spread(members: Sequence[Any], most: int) -> list[Any]:
    """At most `most` of these members, spread evenly from the first to the last."""
    places = np.linspace(0, len(members) - 1, min(most, len(members))).astype(int)
    return [members[place] for place in np.unique(places).tolist()]


def diversity_of(
    task: Task, discount: float, kept: Mapping[str, Sequence[Any]]
) -> dict[str, Measures]:
    """The diversity of both roles, for snapshots in the pools, spread over the run.

    {} if a side does not learn, or has fewer than two snapshots that are tables.
    """
    chosen = {role: spread(members, MOST_SNAPSHOTS) for role, members in kept.items()}
    policies = [member.policy for members in chosen.values() for member in members]
    if len(kept) < 2 or min(map(len, chosen.values())) < 2 or not is_table_duel(task, *policies):
        return {}
    tables = [
        np.stack([table_in(task, one.policy) for one in chosen[role]]) for role in OPPOSING_ROLES
    ]
    return diversity(task.mazes[0], tables[0], tables[1], discount, order_of(task))


def describe_diversity(found: Mapping[str, Measures]) -> str:
    """The measures of both roles as one line of text."""
    parts = []
    for role, one in found.items():
        cycles = "" if one["cycles"] is None else f", {100 * one['cycles']:.0f} % of triples cyclic"
        parts.append(
            f"{role} mean distance {one['distance']:.3f}, effective number "
            f"{one['effective_number']:.2f} of {one['snapshots']}{cycles}"
        )
    return f"Diversity of snapshots: {'; '.join(parts)}"
