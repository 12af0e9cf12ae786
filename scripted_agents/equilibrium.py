"""The exact value and optimal mixed policies of the simultaneous chase, and of matrix games."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.declared import as_array, number, truth, whole
from pursuit.maze import Maze, load_maze
from pursuit.memory import check_memory
from scripted_agents.best_response import MoveOrder
from scripted_agents.game_kernels import solve_matrix
from scripted_agents.places import places_of
from scripted_agents.shapley_iteration import (
    Game,
    Report,
    silent,
    solve_for_ever,
    solve_steps,
)

MAX_BYTES = 3 * 10**9
"""Bound on the memory of a solution."""


@dataclass(frozen=True, eq=False)
class MatrixGame:
    """The solution of a zero-sum matrix game.

    Attributes:
        value: what the row player gets, in expectation, under optimal play.
        row: [m] float64, an optimal strategy of the row player, who maximises.
        column: [n] float64, one of the column player, who minimises.
        pure: whether the two are a pure saddle point.
    """

    value: float
    row: NDArray[np.float64]
    column: NDArray[np.float64]
    pure: bool


def solve_matrix_game(payoff: ArrayLike) -> MatrixGame:
    """Solve a two-player zero-sum game. Von Neumann (1928); the linear program of Dantzig (1951).

    Args:
        payoff: [m, n], what the row player gets and the column player pays.

    Raises:
        ValueError: no matrix, an empty one, or entries that are not finite.
    """
    matrix = as_array("payoff", payoff, "biuf", "give a matrix of numbers").astype(np.float64)
    if matrix.ndim != 2 or matrix.size == 0:
        raise ValueError(f"payoff has shape {matrix.shape}; give a matrix [rows, columns]")
    if not np.isfinite(matrix).all():
        raise ValueError(f"payoff has entries that are not finite: {matrix[~np.isfinite(matrix)]}")
    m, n = matrix.shape
    row, column = np.empty(m), np.empty(n)
    scratch = np.empty((m + 1, n + m + 1)), np.empty(m, dtype=np.int64)
    value, _ = solve_matrix(matrix, *scratch, row, column)
    pure = bool(row.max() == 1.0 and column.max() == 1.0)
    return MatrixGame(float(value), row, column, pure)


@dataclass(frozen=True, eq=False)
class ChaseSolution:
    """What `solve_chase` found; all arrays are read-only, as solutions are kept for the next call.

    Attributes:
        maze: where it is played.
        values: [chaser cell, evader cell] float64 (with two chasers [chaser cell, chaser cell,
            evader cell], and so on): the value of the game, 0 where both stand in one cell.
        chaser_policy: [self, other, action] float64, an optimal policy of the chaser. With several
            chasers [chaser cell, ..., evader cell, joint action], the joint action counting the
            last chaser's fastest.
        evader_policy: [self, other, action] float64, an optimal policy of the evader; with several
            chasers [evader cell, chaser cell, ..., action].
        mixed: of the shape of `values`, bool: whether the matrix game there has no pure saddle
            point, so that optimal play must be random.
        discount: of each step; 1 with a horizon.
        horizon: the number of steps, or None. The policies are those of the first step.
        sweeps: of Shapley's iteration.
    """

    maze: Maze
    values: NDArray[np.float64] = field(repr=False)
    chaser_policy: NDArray[np.float64] = field(repr=False)
    evader_policy: NDArray[np.float64] = field(repr=False)
    mixed: NDArray[np.bool_] = field(repr=False)
    discount: float
    horizon: int | None
    stay_action: bool
    move_order: str
    num_chasers: int
    sweeps: int


def solve_chase(
    maze: Maze,
    discount: float = 0.95,
    stay_action: bool = False,
    horizon: int | None = None,
    move_order: MoveOrder = "simultaneous",
    num_chasers: int = 1,
    report: Report = silent,
) -> ChaseSolution:
    """Solve the chase of one evader by a team of chasers exactly, as a zero-sum stochastic game.

    All choose at once. The payoff is the expected sum of discount**t over the steps t = 0, 1, ...
    up to and including that of the capture; with `horizon` the expected number of steps, cut at the
    horizon. The chasers minimise it, as one player with joint actions; the evader maximises it.
    Shapley (1953), by value iteration, with steps of policy evaluation in between where they help
    (Pollatschek and Avi-Itzhak, 1969).

    Args:
        maze: where it is played.
        discount: what a step counts in terms of the one before it, in (0, 1); not used with a
            horizon.
        stay_action: whether the fifth action exists.
        horizon: the number of steps after which the game is cut, or None.
        move_order: "simultaneous", or "chasers_first": the chasers move first and the evader then,
            if it is not caught yet, but it has chosen its move before.
        num_chasers: size of the team; memory grows with cells ** (num_chasers + 1).
        report: told how far it is, now and then: the share of the work in [0, 1], as far as that
            can be said. A game that was solved before is not solved again, and reports nothing.

    Raises:
        ValueError: an argument outside these limits, or a game that does not fit into memory.
    """
    maze, stay_action = load_maze(maze), truth("stay_action", stay_action)
    if horizon is not None:
        whole("horizon", horizon, 1)
    if horizon is None and not 0.0 < number("discount", discount) < 1.0:
        raise ValueError(f"discount {discount}; it lies in (0, 1). Or give a horizon")
    if move_order not in ("simultaneous", "chasers_first"):
        raise ValueError(f"move_order {move_order!r}; choose 'simultaneous' or 'chasers_first'")
    check_memory(
        f"{maze.name}, {maze.num_cells} cells and {num_chasers} chaser(s),",
        bytes_to_solve(maze.num_cells, whole("num_chasers", num_chasers, 1), stay_action),
        "take a smaller maze or fewer chasers",
        MAX_BYTES,
    )
    return _solve(
        _Quiet(report),
        maze,
        1.0 if horizon is not None else float(discount),
        stay_action,
        horizon,
        move_order == "chasers_first",
        num_chasers,
    )


class _Quiet:
    """A report that makes no difference to what is kept: all of them are equal."""

    def __init__(self, report: Report) -> None:
        self.report = report

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Quiet)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=8)
def _solve(
    report: _Quiet,
    maze: Maze,
    discount: float,
    stay_action: bool,
    horizon: int | None,
    chasers_first: bool,
    num_chasers: int,
) -> ChaseSolution:
    places = places_of(maze, num_chasers, stay_action)
    game = Game(places, discount, chasers_first, report.report)
    if horizon is None:
        values, sweeps = solve_for_ever(game)
    else:
        values, sweeps = solve_steps(game, horizon)
    game.spread(values)
    shape, actions = places.shape, places.neighbors.shape[1]
    chaser_policy, evader_policy = game.chaser_policy, game.evader_policy
    chaser_policy[~places.apart] = 1.0 / chaser_policy.shape[2]
    evader_policy[~places.apart] = 1.0 / actions
    evader_table = np.moveaxis(evader_policy.reshape(*shape, actions), num_chasers, 0)
    solution = ChaseSolution(
        maze,
        values.reshape(shape),
        chaser_policy.reshape(*shape, -1),
        np.ascontiguousarray(evader_table),
        game.mixed.reshape(shape),
        discount,
        horizon,
        stay_action,
        "chasers_first" if chasers_first else "simultaneous",
        num_chasers,
        sweeps,
    )
    for array in (
        solution.values,
        solution.chaser_policy,
        solution.evader_policy,
        solution.mixed,
    ):
        array.flags.writeable = False
    return solution


def bytes_to_solve(cells: int, num_chasers: int, stay_action: bool) -> int:
    """The memory that `solve_chase` needs, about: policies, values, and a sparse linear system."""
    actions = 5 if stay_action else 4
    # The policies, with copies while they are given to the teams in another order; arrays of
    # values; the system of the sorted teams with its factors, some 800 bytes a row.
    per_place = 8 * (2 * actions**num_chasers + 2 * actions + 8) + 800 // math.factorial(
        num_chasers
    )
    return int(per_place * cells ** (num_chasers + 1))
