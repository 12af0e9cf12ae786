"""The exact value and optimal mixed policies of the simultaneous chase, and of matrix games."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.declared import as_array, number, truth, whole
from pursuit.maze import Maze, load_maze
from scripted_agents.best_response import MoveOrder
from scripted_agents.game_kernels import evaluate, shapley, solve_matrix

TOLERANCE = 1e-10
"""How exact the values are, relative to the largest."""

MAX_BYTES = 3 * 10**9
"""Bound on the memory of a solution."""

MAX_SWEEPS = 100_000


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
    whole("num_chasers", num_chasers, 1)
    actions = 5 if stay_action else 4
    needed = 8 * maze.num_cells ** (num_chasers + 1) * (actions**num_chasers + actions + 3)
    if needed > MAX_BYTES:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells and {num_chasers} chaser(s) need "
            f"{needed / 1e9:.3g} GB; at most {MAX_BYTES / 1e9:g} GB are used. Take a smaller maze "
            "or fewer chasers"
        )
    return _solve(
        maze,
        1.0 if horizon is not None else float(discount),
        stay_action,
        horizon,
        move_order == "chasers_first",
        num_chasers,
    )


@lru_cache(maxsize=8)
def _solve(
    maze: Maze,
    discount: float,
    stay_action: bool,
    horizon: int | None,
    chasers_first: bool,
    num_chasers: int,
) -> ChaseSolution:
    size, actions = maze.num_cells, 5 if stay_action else 4
    neighbors = np.ascontiguousarray(maze.neighbors[:, :actions])
    teams = np.array(list(product(range(size), repeat=num_chasers)), dtype=np.int32)
    chaser_policy = np.zeros((len(teams), size, actions**num_chasers))
    evader_policy = np.zeros((len(teams), size, actions))
    mixed = np.zeros((len(teams), size), dtype=bool)
    policies = (discount, chasers_first, chaser_policy, evader_policy)
    useful = distinct_moves(neighbors)

    def sweep(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        target = np.empty_like(values)
        arrays = (values, target, teams, neighbors, useful, *policies, mixed)
        return target, float(shapley(*arrays, 0, len(teams)))

    values = np.zeros((len(teams), size))
    sweeps = 0
    if horizon is not None:
        for _ in range(horizon):
            values, change = sweep(values)
            sweeps += 1
            if change == 0.0:
                break
    else:
        # Shapley's map shrinks differences by the discount. Evaluating the two policies that it
        # found is Newton's method: a few steps where it works, but it may also circle. So its
        # result is kept only where the next change is smaller than without it.
        plain, bound, jumped = values, np.inf, False
        for sweeps in range(1, MAX_SWEEPS):  # noqa: B007 -- used below
            following, change = sweep(values)
            if jumped and change > discount * bound:
                values, jumped = plain, False
                continue
            if change * discount / (1.0 - discount) <= TOLERANCE * max(1.0, following.max()):
                values = following
                break
            plain, bound, jumped = following, change, True
            values = following.copy()
            evaluate(values, teams, neighbors, *policies, 0.01 * change, 1000)
        else:
            raise ValueError(
                f"{maze.name}: no convergence within {MAX_SWEEPS} sweeps at discount {discount}; "
                "take a smaller one, or a horizon"
            )
    shape = (size,) * (num_chasers + 1)
    apart = (teams[:, :, None] != np.arange(size)).all(axis=1)
    chaser_policy[~apart], evader_policy[~apart] = 1.0 / chaser_policy.shape[2], 1.0 / actions
    evader_table = np.moveaxis(evader_policy.reshape(*shape, actions), num_chasers, 0)
    solution = ChaseSolution(
        maze,
        values.reshape(shape),
        chaser_policy.reshape(*shape, -1),
        np.ascontiguousarray(evader_table),
        mixed.reshape(shape),
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


def distinct_moves(neighbors: NDArray[np.int32]) -> NDArray[np.bool_]:
    """[cells, actions] bool: False for an action that leads where an earlier one does."""
    useful = np.ones(neighbors.shape, dtype=bool)
    for action in range(1, neighbors.shape[1]):
        useful[:, action] = (neighbors[:, :action] != neighbors[:, action : action + 1]).all(axis=1)
    return useful
